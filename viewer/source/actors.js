// The list of all actors, with a search, from which one is chosen to be followed.

import { buttonOf, byId, element, letterMark, moveFocus, press, swatch } from "./elements.js";
import { moves, rank } from "./recorded.js";

const MOST = 200; // actors that are listed at once

/** @typedef {{ recording: Recorded, actor: number, words: string, button: HTMLButtonElement }} Entry */

export class Actors {
  /** @param {Recorded[]} recordings @param {(recording: Recorded, actor: number) => void} choose
   * @param {() => void} changed is called when other actors are listed */
  constructor(recordings, choose, changed) {
    this.choose = choose;
    this.changed = changed;
    this.search = /** @type {HTMLInputElement} */ (byId("search"));
    this.list = byId("actor-list");
    this.panels = [byId("incidents-panel"), byId("actors-panel")];
    this.entries = recordings.flatMap((recording) => {
      const { actors, own } = recording.tracks;
      const isAlone = (/** @type {number} */ actor) => !recording.index || (moves(actors[actor]) && recording.twin(actor) < 0);
      const listed = recording.order.filter((actor) => own[actor].length && actors[actor].kind !== "sensor" && isAlone(actor));
      listed.sort((a, b) => rank(actors[b]) - rank(actors[a]) || a - b);
      return listed.map((actor) => this.entry(recording, actor, recordings.length > 1));
    });
    this.shown = /** @type {Entry[]} */ ([]);
    this.search.addEventListener("input", () => this.find());
    this.search.addEventListener("keydown", (event) => this.key(event));
    this.list.addEventListener("keydown", (event) => moveFocus(event, this.shown.map(({ button }) => button)));
    ["incidents-tab", "actors-tab"].forEach((id, index) => byId(id).addEventListener("click", () => this.open(index === 1)));
    byId("actors-count").textContent = String(this.entries.length);
    this.find();
  }

  /** @param {Recorded} recording @param {number} actor @param {boolean} several @returns {Entry} */
  entry(recording, actor, several) {
    const { id, type, kind, label, role, color } = recording.tracks.actors[actor];
    const parts = [...(several ? [letterMark(recording.letter)] : []), swatch(color), element("span", "", label), element("small", "", type || kind)];
    const button = buttonOf("actor", parts, () => this.choose(recording, actor));
    button.title = `Follow ${label}`;
    return { recording, actor, button, words: `${label} ${type} ${kind} ${role} ${id}`.toLowerCase() };
  }

  get isOpen() {
    return !this.panels[1].hidden;
  }

  /** Show the actors instead of the incidents, or the other way around. @param {boolean} actors */
  open(actors) {
    this.panels.forEach((panel, index) => (panel.hidden = actors !== (index === 1)));
    press("actors-tab", actors);
    press("incidents-tab", !actors);
    this.changed();
  }

  startSearch() {
    this.open(true);
    this.search.focus();
    this.search.select();
  }

  /** List the actors in whose name, type, role or id all words are. */
  find() {
    const words = this.search.value.toLowerCase().split(/\s+/);
    const found = this.entries.filter((entry) => words.every((word) => entry.words.includes(word)));
    this.shown = found.slice(0, MOST);
    this.list.replaceChildren(...this.shown.map(({ button }) => element("li", "", "", [button])));
    const more = found.length > MOST ? `and ${found.length - MOST} more` : "";
    byId("actors-note").textContent = found.length ? more : "No actor is found.";
    this.changed();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    event.stopPropagation();
    if (event.key === "ArrowDown") this.shown[0]?.button.focus();
    else if (event.key === "Enter") this.shown[0]?.button.click();
    else if (event.key === "Escape" && this.search.value) this.search.value = "";
    else if (event.key === "Escape") {
      this.open(false);
      byId("incidents-tab").focus();
    } else return;
    event.preventDefault();
    if (event.key === "Escape") this.find();
  }

  /** Mark the followed actor, and those that are absent. @param {number} time @param {number[] | null} followed */
  show(time, followed) {
    if (!this.isOpen) return;
    for (const { recording, actor, button } of this.shown) {
      const { tracks } = recording;
      const id = followed?.[recording.index];
      button.ariaCurrent = id !== undefined && tracks.indexOf(id, time) === actor ? "true" : null;
      button.classList.toggle("absent", tracks.trackAt(actor, tracks.sampleAt(time)) < 0);
    }
  }
}
