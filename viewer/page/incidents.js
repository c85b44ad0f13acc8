// The list of incidents.
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
  /** open: is called with the index of the chosen incident. */
  constructor(report, tracks, open) {
    this.incidents = report.incidents;
    this.tracks = tracks;
    this.open = open;
    this.current = -1;
    this.hidden = new Set(); // kinds
    this.list = document.getElementById("list");
    this.nothing = document.getElementById("nothing");
    this.items = this.incidents.map((incident, index) => this.item(incident, index));
    this.list.append(...this.items.map(({ row }) => row));
    this.list.addEventListener("keydown", (event) => this.key(event));
    this.addFilters();
    this.filter();
    const unseen = this.items.filter(({ replayed }) => !replayed).length;
    const notes = [];
    if (!report.whole) notes.push("A long recording: the replay has the time around incidents.");
    if (unseen) notes.push(`${unseen} of ${this.items.length} incidents are listed without a replay.`);
    if (report.omitted) notes.push(`${report.omitted} more are not listed.`);
    const note = document.getElementById("note");
    note.textContent = notes.join(" ");
    note.hidden = !notes.length;
  }

  item(incident, index) {
    const { name, icon: path } = KINDS[incident.kind];
    const replayed = incident.start !== null && this.tracks.covers(incident.start);
    const badge = element("span", "badge", "", [icon(path), element("span", "", name)]);
    const top = element("span", "top", "", [badge, element("time", "", when(incident))]);
    const body = element("span", "body", "", [top, element("span", "text", incident.text), this.meta(incident)]);
    const button = element("button", "incident", "", [body]);
    button.type = "button";
    button.dataset.kind = incident.kind;
    button.disabled = !replayed;
    button.addEventListener("click", () => this.open(index));
    if (incident.picture) {
      const picture = element("img", "picture");
      Object.assign(picture, { src: incident.picture, alt: "", loading: "lazy", decoding: "async", width: 640, height: 400 });
      button.prepend(picture);
    }
    return { row: element("li", "", "", [button]), button, replayed, kind: incident.kind };
  }

  meta({ actors, types, place }) {
    const names = actors.map((id, i) => this.name(id, types[i] ?? ""));
    const where = place[0] === null || place[1] === null ? "" : `x ${place[0].toFixed(1)}  y ${place[1].toFixed(1)} m`;
    const chips = names.map(({ text, color }) => {
      const swatch = element("i", "swatch");
      swatch.style.background = color;
      return element("span", "chip", "", [swatch, element("span", "", text)]);
    });
    return element("span", "meta", "", [...chips, ...(where ? [element("span", "place", where)] : [])]);
  }

  name(id, type) {
    const actor = this.tracks.actors[this.tracks.indexOf(id, Infinity)];
    if (actor) return { text: actor.label, color: actor.color };
    return { text: id === 0xffffffff ? "no actor" : `${type || "actor"} ${id}`, color: "#969696" };
  }

  addFilters() {
    const filters = document.getElementById("filters");
    for (const [kind, { many, icon: path }] of Object.entries(KINDS)) {
      const count = this.incidents.filter((incident) => incident.kind === kind).length;
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
      });
      filters.append(button);
    }
    filters.hidden = filters.children.length < 2;
  }

  filter() {
    for (const { row, kind } of this.items) row.hidden = this.hidden.has(kind);
    const some = this.items.some(({ row }) => !row.hidden);
    this.nothing.hidden = some;
    this.nothing.textContent = this.items.length
      ? "All kinds of incidents are hidden."
      : "Nobody collided, braked hard or stood still for long.";
  }

  /** Mark the chosen incident. */
  choose(index) {
    if (index === this.current) return;
    this.items[this.current]?.button.removeAttribute("aria-current");
    this.current = index;
    const button = this.items[index]?.button;
    if (!button) return;
    button.setAttribute("aria-current", "true");
    const [box, frame] = [button.getBoundingClientRect(), this.list.getBoundingClientRect()];
    const scrolls = this.list.scrollHeight > this.list.clientHeight;
    if (scrolls && (box.top < frame.top || box.bottom > frame.bottom)) button.scrollIntoView({ block: "nearest" });
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

function when({ start, stop }) {
  if (start === null) return "–";
  return stop !== null && stop - start >= 1 ? `${clockTime(start)} – ${clockTime(stop)}` : clockTime(start);
}
