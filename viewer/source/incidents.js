// The lists of incidents, one for each recording.

import { clockTime } from "./clock.js";
import { countUntil } from "./data.js";
import { buttonOf, byId, decimal, element, icon, letterMark, moveFocus, swatch } from "./elements.js";

/** s before an incident at which it is played from */
export const BEFORE = 3;

export class Incidents {
  /** open: is called with the index of the chosen incident, and filtered when kinds are hidden or shown.
   * @param {Recorded[]} recordings @param {import("./pictures").Pictures} pictures @param {(index: number) => void} open
   * @param {() => void} filtered */
  constructor(recordings, pictures, open, filtered) {
    this.recordings = recordings;
    this.pictures = pictures;
    this.open = open;
    this.filtered = filtered;
    this.current = -1;
    this.hidden = /** @type {Set<string>} */ (new Set()); // kinds
    this.items = /** @type {Item[]} */ ([]); // of all recordings, in order
    this.nothing = byId("nothing");
    this.scroller = byId("lists");
    for (const recording of recordings) this.addList(recording);
    this.scroller.addEventListener("keydown", (event) => this.key(event));
    this.played = this.items.filter(({ replayed }) => replayed).sort((a, b) => a.start - b.start);
    this.starts = this.played.map(({ start }) => start);
    byId("incidents-count").textContent = String(this.items.length);
    this.addFilters();
    this.filter();
    this.addNote();
  }

  /** @param {Recorded} recording */
  addList(recording) {
    const { incidents } = recording.report;
    const list = element("ol", "list");
    list.id = recording.index ? "other-list" : "list";
    if (this.recordings.length > 1) {
      const name = element("b", "", recording.report.source);
      const title = element("h3", "", "", [letterMark(recording.letter), name]);
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
    const note = byId("note");
    note.textContent = notes.join(" ");
    note.hidden = !notes.length;
  }

  /** @param {Recorded} recording @param {Incident} incident @param {number} index @returns {Item} */
  item(recording, incident, index) {
    const { name, icon: path } = KINDS[incident.kind];
    const replayed = incident.start !== null && recording.tracks.covers(incident.start);
    const badge = element("span", "badge", "", [icon(path), element("span", "", name)]);
    const top = element("span", "top", "", [badge, element("time", "", when(incident))]);
    const body = element("span", "body", "", [top, element("span", "text", "", breakable(incident.text)), this.meta(recording, incident)]);
    const button = buttonOf("incident", [body], () => this.open(index));
    button.title = `Play from ${BEFORE} s before it`;
    button.dataset.kind = incident.kind;
    button.disabled = !replayed;
    const drawn = recording.report.drawn && replayed;
    if (incident.picture || drawn) button.prepend(this.pictures.image(recording, incident));
    const other = this.recordings.find((each) => each !== recording);
    if (other?.report.incidents.length && !other.has(incident)) badge.append(element("span", "only", `only in ${recording.letter}`));
    const row = element("li", "", "", [button]);
    return { row, button, replayed, recording, incident, kind: incident.kind, index, start: incident.start ?? 0 };
  }

  /** @param {Recorded} recording @param {Incident} incident */
  meta(recording, { actors, types, place }) {
    const names = actors.map((id, i) => this.name(recording, id, types[i] ?? ""));
    const where = !place ? "" : `x ${decimal(place[0], 1)}  y ${decimal(place[1], 1)} m`;
    const chips = names.map(({ text, color }) => element("span", "chip", "", [swatch(color), element("span", "", text)]));
    return element("span", "meta", "", [...chips, ...(where ? [element("span", "place", where)] : [])]);
  }

  /** @param {Recorded} recording @param {number} id @param {string} type */
  name({ tracks }, id, type) {
    const actor = tracks.actors[tracks.indexOf(id, Infinity)];
    if (actor) return { text: actor.label, color: actor.color };
    return { text: id === 0xffffffff ? "no actor" : `${type || "actor"} ${id}`, color: "#969696" };
  }

  addFilters() {
    const filters = byId("filters");
    for (const [kind, { many, icon: path }] of Object.entries(KINDS)) {
      const count = this.items.filter((item) => item.kind === kind).length;
      if (!count) continue;
      const parts = [icon(path), element("span", "", many), element("b", "", String(count))];
      const button = buttonOf("filter", parts, () => {
        if (!this.hidden.delete(kind)) this.hidden.add(kind);
        button.ariaPressed = String(!this.hidden.has(kind));
        this.filter();
        this.filtered();
      });
      button.dataset.kind = kind;
      button.ariaPressed = "true";
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

  /** Mark the chosen incident. @param {number} index */
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

  /** @param {Item | undefined} item @param {boolean} current */
  mark(item, current) {
    if (!item) return;
    item.button.ariaCurrent = current ? "true" : null;
    this.pictures.enlarge(item.button.querySelector("img"), current);
  }

  /** Return the latest incident that began in an interval. @param {number} start @param {number} stop */
  latestIn(start, stop) {
    const [first, last] = [start, stop].map((time) => countUntil(this.starts, time));
    return this.played.slice(first, last).at(-1);
  }

  /** Return the next incident that can be shown, or with -1 the one before; if none is chosen, the latest one at a time.
   * @param {number} step @param {number} time */
  neighbour(step, time) {
    if (step < 0 && this.current < 0) return this.played.findLast(({ row, start }) => !row.hidden && start <= time)?.index ?? -1;
    /** @param {Item} item */
    const next = ({ index, replayed, row }) => replayed && !row.hidden && (index - this.current) * step > 0;
    return (step > 0 ? this.items.find(next) : this.items.findLast(next))?.index ?? -1;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const buttons = this.items.filter(({ row, replayed }) => replayed && !row.hidden).map(({ button }) => button);
    moveFocus(event, buttons);
  }
}

const NO_INCIDENTS = "There are no incidents.";

/** @param {number} count */
export function counted(count) {
  return count === 1 ? "1 incident" : `${count || "no"} incidents`;
}

/** @param {Incident} incident */
function when({ start, stop }) {
  if (start === null) return "–";
  return stop !== null && stop - start >= 1 ? `${clockTime(start)} – ${clockTime(stop)}` : clockTime(start);
}

/** Return a text as nodes, with breaks allowed behind the dots of names. @param {string} text */
function breakable(text) {
  return text.split(/(?<=[a-z]\.)(?=\w)/).flatMap((part, index) => (index ? [element("wbr", ""), part] : [part]));
}
