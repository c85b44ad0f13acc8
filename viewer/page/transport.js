// Play, pause, speed, and the timeline with its marks.
"use strict";

const ONE = 11; // px, the room of a mark
const SEVERAL = 31; // px, that of a mark with a number

class Transport {
  /** open: is called with the index of an incident. */
  constructor(clock, length, incidents, open) {
    this.clock = clock;
    this.length = length;
    this.incidents = incidents;
    this.open = open;
    this.slider = document.getElementById("time");
    this.now = document.getElementById("now");
    this.button = document.getElementById("play");
    this.pace = document.getElementById("pace");
    this.marks = document.getElementById("marks");
    this.slider.max = String(this.length);
    this.slider.disabled = this.button.disabled = clock.stop <= clock.start;
    document.getElementById("end").textContent = clockTime(this.length);
    this.slider.addEventListener("input", () => clock.seek(Number(this.slider.value)));
    this.button.addEventListener("click", () => clock.toggle());
    this.pace.addEventListener("change", () => clock.setPace(Number(this.pace.value)));
    clock.addEventListener("state", () => this.showState());
    this.addSpans();
    new ResizeObserver(() => this.addMarks()).observe(this.marks);
    this.addMarks();
    this.showState();
  }

  share(time) {
    return this.length ? `${(100 * Math.min(1, time / this.length)).toFixed(3)}%` : "0%";
  }

  /** Draw the intervals of the recording that can be shown. */
  addSpans() {
    const covered = document.getElementById("covered");
    for (const [start, stop] of this.clock.spans) {
      const bar = element("i");
      bar.style.left = this.share(start);
      bar.style.width = this.share(stop - start);
      covered.append(bar);
    }
  }

  /** Show where two recordings begin to differ. */
  addDifference(time) {
    const bar = element("i", "difference");
    bar.style.left = this.share(time);
    document.getElementById("covered").append(bar);
  }

  /** Draw marks of the incidents that can be shown; those that would overlap are one mark, with their number. */
  addMarks() {
    const width = this.marks.clientWidth;
    if (width && width === this.width && this.hidden === [...this.incidents.hidden].join()) return;
    this.width = width;
    this.hidden = [...this.incidents.hidden].join();
    this.marks.replaceChildren();
    for (const index of new Set(this.incidents.items.map(({ recording }) => recording.index))) {
      const items = this.incidents.items
        .map((item, index) => ({ ...item, index }))
        .filter(({ replayed, row, recording }) => replayed && !row.hidden && recording.index === index)
        .sort((a, b) => a.incident.start - b.incident.start);
      let group = [];
      for (const item of items) {
        const apart = group.length ? this.distance(group[0], item) : 0;
        const rooms = [group.length > 1, this.crowded(items, item)].map((several) => (several ? SEVERAL : ONE));
        if (group.length && apart >= (rooms[0] + rooms[1]) / 2) {
          this.addMark(group);
          group = [];
        }
        group.push(item);
      }
      if (group.length) this.addMark(group);
    }
  }

  /** Return how many px an incident is after another one on the timeline. */
  distance(before, after) {
    return this.length ? ((after.incident.start - before.incident.start) / this.length) * this.width : 0;
  }

  /** Return whether another incident follows so soon that both become one mark. */
  crowded(items, item) {
    const next = items[items.indexOf(item) + 1];
    return next !== undefined && this.distance(item, next) < (ONE + SEVERAL) / 2;
  }

  addMark(group) {
    const worst = Object.keys(KINDS).find((kind) => group.some((item) => item.kind === kind));
    const mark = element("button", "mark", group.length > 1 ? (group.length > 99 ? "99+" : String(group.length)) : "");
    const lines = group.slice(0, 8).map(({ incident }) => `${clockTime(incident.start)} ${incident.text}`);
    mark.type = "button";
    const several = `${group.length} incidents; a click plays one after the other:`;
    mark.title = [...(group.length > 1 ? [several] : []), ...lines, ...(group.length > 8 ? [`and ${group.length - 8} more`] : [])].join("\n");
    mark.setAttribute("aria-label", group.length > 1 ? `${group.length} incidents` : mark.title);
    mark.classList.toggle("cluster", group.length > 1);
    mark.classList.toggle("below", group[0].recording.index > 0);
    mark.dataset.kind = worst;
    mark.style.left = this.share(group[0].incident.start);
    mark.addEventListener("click", () => {
      const indices = group.map(({ index }) => index);
      this.open(indices[(indices.indexOf(this.incidents.current) + 1) % indices.length]); // one after the other
    });
    this.marks.append(mark);
  }

  /** Change the speed by a step. */
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
