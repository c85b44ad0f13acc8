// The lists of incidents, one for each recording.
"use strict";

/** Return an element with a class, a text and children. */
function element(name, className = "", text = "", children = []) {
  const node = document.createElement(name);
  if (className) node.className = className;
  if (text) node.textContent = text;
  node.append(...children);
  return node;
}

/** Return an icon with a path. */
function icon(path) {
  const space = "http://www.w3.org/2000/svg";
  const drawing = document.createElementNS(space, "svg");
  const line = document.createElementNS(space, "path");
  drawing.setAttribute("viewBox", "0 0 16 16");
  drawing.setAttribute("aria-hidden", "true");
  line.setAttribute("d", path);
  drawing.append(line);
  return drawing;
}

class Incidents {
  /** open: is called with the index of the chosen incident, and filtered when kinds are hidden or shown. */
  constructor(recordings, pictures, open, filtered) {
    this.recordings = recordings;
    this.pictures = pictures;
    this.open = open;
    this.filtered = filtered;
    this.current = -1;
    this.hidden = new Set(); // kinds
    this.items = []; // of all recordings, in order
    this.nothing = document.getElementById("nothing");
    this.scroller = document.getElementById("lists");
    for (const recording of recordings) this.addList(recording);
    this.scroller.addEventListener("keydown", (event) => this.key(event));
    this.addFilters();
    this.filter();
    this.addNote();
  }

  addList(recording) {
    const { incidents } = recording.report;
    const list = element("ol", "list");
    list.id = recording.index ? "other-list" : "list";
    if (this.recordings.length > 1) {
      const name = element("b", "", recording.report.source);
      const title = element("h3", "", "", [element("i", `letter of-${recording.letter}`, recording.letter), name]);
      title.append(element("span", "", counted(incidents.length)));
      this.scroller.append(title);
    }
    for (const incident of incidents) {
      const item = this.item(recording, incident, this.items.length);
      this.items.push(item);
      list.append(item.row);
    }
    this.scroller.append(list);
    if (!incidents.length && this.recordings.length > 1) this.scroller.append(element("p", "nothing small", NO_INCIDENTS));
  }

  addNote() {
    const unseen = this.items.filter(({ replayed }) => !replayed).length;
    const omitted = this.recordings.reduce((sum, { report }) => sum + report.omitted, 0);
    const notes = [];
    if (!this.recordings.every(({ report }) => report.whole)) {
      notes.push("A long recording: the replay has the time around incidents.");
    }
    if (unseen) notes.push(`${unseen} of ${this.items.length} incidents are listed without a replay.`);
    if (omitted) notes.push(`${omitted} more are not listed.`);
    const note = document.getElementById("note");
    note.textContent = notes.join(" ");
    note.hidden = !notes.length;
  }

  item(recording, incident, index) {
    const { name, icon: path } = KINDS[incident.kind];
    const replayed = incident.start !== null && recording.tracks.covers(incident.start);
    const badge = element("span", "badge", "", [icon(path), element("span", "", name)]);
    const top = element("span", "top", "", [badge, element("time", "", when(incident))]);
    const body = element("span", "body", "", [top, element("span", "text", "", breakable(incident.text)), this.meta(recording, incident)]);
    const button = element("button", "incident", "", [body]);
    button.type = "button";
    button.title = `Play from ${BEFORE} s before it`;
    button.dataset.kind = incident.kind;
    button.disabled = !replayed;
    button.addEventListener("click", () => this.open(index));
    const drawn = recording.report.drawn && replayed;
    if (incident.picture || drawn) button.prepend(this.pictures.image(recording, incident));
    const other = this.recordings.find((each) => each !== recording);
    if (other?.report.incidents.length && !other.has(incident)) top.firstChild.append(element("span", "only", `only in ${recording.letter}`));
    return { row: element("li", "", "", [button]), button, replayed, recording, incident, kind: incident.kind };
  }

  meta(recording, { actors, types, place }) {
    const names = actors.map((id, i) => this.name(recording, id, types[i] ?? ""));
    const where = place[0] === null || place[1] === null ? "" : `x ${metres(place[0])}  y ${metres(place[1])} m`;
    const chips = names.map(({ text, color }) => {
      const swatch = element("i", "swatch");
      swatch.style.background = color;
      return element("span", "chip", "", [swatch, element("span", "", text)]);
    });
    return element("span", "meta", "", [...chips, ...(where ? [element("span", "place", where)] : [])]);
  }

  name({ tracks }, id, type) {
    const actor = tracks.actors[tracks.indexOf(id, Infinity)];
    if (actor) return { text: actor.label, color: actor.color };
    return { text: id === 0xffffffff ? "no actor" : `${type || "actor"} ${id}`, color: "#969696" };
  }

  addFilters() {
    const filters = document.getElementById("filters");
    for (const [kind, { many, icon: path }] of Object.entries(KINDS)) {
      const count = this.items.filter((item) => item.kind === kind).length;
      if (!count) continue;
      const button = element("button", "filter", "", [icon(path), element("span", "", many), element("b", "", String(count))]);
      button.type = "button";
      button.dataset.kind = kind;
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        const hide = !this.hidden.has(kind);
        if (hide) this.hidden.add(kind);
        else this.hidden.delete(kind);
        button.setAttribute("aria-pressed", String(!hide));
        this.filter();
        this.filtered();
      });
      filters.append(button);
    }
    filters.hidden = filters.children.length < 2;
  }

  filter() {
    for (const { row, kind } of this.items) row.hidden = this.hidden.has(kind);
    const some = this.items.some(({ row }) => !row.hidden) || (this.recordings.length > 1 && !this.items.length);
    this.nothing.hidden = some;
    this.nothing.textContent = this.items.length ? "All kinds of incidents are hidden." : NO_INCIDENTS;
  }

  /** Mark the chosen incident. */
  choose(index) {
    if (index === this.current) return;
    this.mark(this.items[this.current], false);
    this.current = index;
    const button = this.items[index]?.button;
    if (!button) return;
    this.mark(this.items[index], true);
    const [box, frame] = [button.getBoundingClientRect(), this.scroller.getBoundingClientRect()];
    const scrolls = this.scroller.scrollHeight > this.scroller.clientHeight;
    if (scrolls && (box.top < frame.top || box.bottom > frame.bottom)) button.scrollIntoView({ block: "nearest" });
  }

  mark(item, current) {
    if (!item) return;
    if (current) item.button.setAttribute("aria-current", "true");
    else item.button.removeAttribute("aria-current");
    this.pictures.enlarge(item.button.querySelector("img"), current);
  }

  /** Return the next incident that can be shown, or with -1 the one before. */
  neighbour(step) {
    const start = this.current < 0 && step < 0 ? 0 : this.current;
    for (let index = start + step; this.items[index]; index += step) {
      if (this.items[index].replayed && !this.items[index].row.hidden) return index;
    }
    return -1;
  }

  key(event) {
    const buttons = this.items.filter(({ row, replayed }) => replayed && !row.hidden).map(({ button }) => button);
    const at = buttons.indexOf(document.activeElement);
    const goal = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: buttons.length - 1 }[event.key];
    if (goal === undefined || at < 0) return;
    event.preventDefault();
    event.stopPropagation();
    buttons[goal]?.focus();
  }
}

const NO_INCIDENTS = "There are no incidents.";

function metres(value) {
  return (Math.abs(value) < 0.05 ? 0 : value).toFixed(1).replace("-", "−");
}

function counted(count) {
  return count === 1 ? "1 incident" : `${count || "no"} incidents`;
}

function when({ start, stop }) {
  if (start === null) return "–";
  return stop !== null && stop - start >= 1 ? `${clockTime(start)} – ${clockTime(stop)}` : clockTime(start);
}

/** Return a text as nodes, with breaks allowed behind the dots of names. */
function breakable(text) {
  return text.split(/(?<=[a-z]\.)(?=\w)/).flatMap((part, index) => (index ? [element("wbr", ""), part] : [part]));
}
