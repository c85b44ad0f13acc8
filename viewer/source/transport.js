// Play, pause, speed, and the timeline with its marks.

import { clockTime } from "./clock.js";
import { buttonOf, byId, element } from "./elements.js";
import { zoomable } from "./part.js";
import { Pointing } from "./pointing.js";

const ONE = 11; // px, the room of a mark
const SEVERAL = 31; // px, that of a mark with a number

export class Transport {
  /** open: is called with the index of an incident.
   * @param {import("./clock").Clock} clock @param {import("./part").Part} part
   * @param {import("./incidents").Incidents} incidents @param {(index: number) => void} open */
  constructor(clock, part, incidents, open) {
    this.clock = clock;
    this.part = part;
    this.incidents = incidents;
    this.open = open;
    this.slider = /** @type {HTMLInputElement} */ (byId("time"));
    this.now = byId("now");
    this.button = /** @type {HTMLButtonElement} */ (byId("play"));
    this.pace = /** @type {HTMLSelectElement} */ (byId("pace"));
    this.marks = byId("marks");
    this.covered = byId("covered");
    this.overview = byId("overview");
    this.difference = /** @type {number | null} */ (null); // when two recordings begin to differ
    this.drawn = ""; // what the marks are of
    this.slider.disabled = this.button.disabled = clock.stop <= clock.start;
    byId("end").textContent = clockTime(part.length);
    this.slider.addEventListener("input", () => clock.seek(Number(this.slider.value)));
    this.pace.addEventListener("change", () => {
      clock.setPace(Number(this.pace.value));
      this.pace.blur();
    });
    new Pointing(this.overview, { drag: (right, down, left) => part.centre((left / this.overview.clientWidth) * part.length) });
    clock.addEventListener("state", () => this.showState());
    part.addEventListener("change", () => this.showPart());
    zoomable(byId("timeline"), part, () => this.marks.clientWidth);
    new ResizeObserver(() => this.addMarks()).observe(this.marks);
    this.showPart();
    this.showState();
  }

  /** Return where a time is on the timeline. @param {number} time */
  share(time) {
    return `${(100 * Math.min(1, Math.max(0, this.part.share(time)))).toFixed(3)}%`;
  }

  /** Show the part of the time that the timeline has: what can be shown of it, and its marks. */
  showPart() {
    const { start, stop, length, isWhole } = this.part;
    [this.slider.min, this.slider.max] = [String(start), String(stop)];
    this.overview.hidden = isWhole;
    const thumb = /** @type {HTMLElement} */ (this.overview.firstElementChild);
    thumb.style.left = `${(100 * start) / length}%`;
    thumb.style.width = `${(100 * (stop - start)) / length}%`;
    const spans = this.clock.spans.filter(([from, to]) => from < stop && to > start);
    this.covered.replaceChildren(...spans.map(([from, to]) => {
      const bar = element("i");
      bar.style.left = this.share(from);
      bar.style.width = `${100 * (Math.min(1, this.part.share(to)) - Math.max(0, this.part.share(from)))}%`;
      return bar;
    }));
    if (this.difference !== null && start <= this.difference && this.difference <= stop) {
      const bar = element("i", "difference");
      bar.style.left = this.share(this.difference);
      this.covered.append(bar);
    }
    this.addMarks();
    this.showTime();
  }

  /** Draw marks of the incidents that can be shown; those that would overlap are one mark, with their number. */
  addMarks() {
    const width = this.marks.clientWidth;
    const { start, stop } = this.part;
    const drawn = [width, start, stop, ...this.incidents.hidden].join();
    if (width && drawn === this.drawn) return;
    this.drawn = drawn;
    const focused = document.activeElement instanceof HTMLElement ? document.activeElement.dataset.incident : undefined;
    this.marks.replaceChildren();
    const shown = this.incidents.played.filter((item) => !item.row.hidden && item.start >= start && item.start <= stop);
    for (const { index } of this.incidents.recordings) {
      const items = shown.filter(({ recording }) => recording.index === index);
      const lefts = items.map((item) => this.part.share(item.start) * width);
      let group = /** @type {Item[]} */ ([]);
      let first = 0;
      items.forEach((item, at) => {
        const crowded = lefts[at + 1] - lefts[at] < (ONE + SEVERAL) / 2; // another one follows so soon that both become one mark
        const rooms = [group.length > 1, crowded].map((several) => (several ? SEVERAL : ONE));
        if (group.length && lefts[at] - lefts[first] >= (rooms[0] + rooms[1]) / 2) {
          this.addMark(group);
          group = [];
        }
        if (!group.length) first = at;
        group.push(item);
      });
      if (group.length) this.addMark(group);
    }
    if (focused) /** @type {HTMLElement | null} */ (this.marks.querySelector(`[data-incident="${focused}"]`))?.focus();
  }

  /** @param {Item[]} group */
  addMark(group) {
    const worst = Object.keys(KINDS).find((kind) => group.some((item) => item.kind === kind));
    const indices = group.map(({ index }) => index);
    const text = group.length > 1 ? (group.length > 99 ? "99+" : String(group.length)) : "";
    const mark = buttonOf("mark", [text], () => {
      this.open(indices[(indices.indexOf(this.incidents.current) + 1) % indices.length]); // one after the other
    });
    const lines = group.slice(0, 8).map(({ incident, start }) => `${clockTime(start)} ${incident.text}`);
    const several = `${group.length} incidents; a click plays one after the other:`;
    mark.title = [...(group.length > 1 ? [several] : []), ...lines, ...(group.length > 8 ? [`and ${group.length - 8} more`] : [])].join("\n");
    mark.setAttribute("aria-label", group.length > 1 ? `${group.length} incidents` : mark.title);
    mark.classList.toggle("cluster", group.length > 1);
    mark.classList.toggle("below", group[0].recording.index > 0);
    mark.dataset.kind = worst;
    mark.dataset.incident = String(group[0].index);
    mark.style.left = this.share(group[0].start);
    this.marks.append(mark);
  }

  /** Change the speed by a step. @param {number} step */
  changePace(step) {
    const { options } = this.pace;
    this.pace.selectedIndex = Math.min(options.length - 1, Math.max(0, this.pace.selectedIndex + step));
    this.clock.setPace(Number(this.pace.value));
  }

  showState() {
    const { playing } = this.clock;
    this.button.classList.toggle("playing", playing);
    this.button.setAttribute("aria-label", playing ? "Pause" : "Play");
  }

  showTime() {
    const { time } = this.clock;
    this.now.textContent = clockTime(time);
    this.slider.value = String(time);
    this.slider.style.setProperty("--share", this.share(time));
    this.slider.setAttribute("aria-valuetext", `${time.toFixed(1)} seconds`);
  }
}
