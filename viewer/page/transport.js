// Play, pause, speed, and the timeline with its marks.
"use strict";

class Transport {
  constructor(clock, report, open) {
    this.clock = clock;
    this.report = report;
    this.slider = document.getElementById("time");
    this.now = document.getElementById("now");
    this.button = document.getElementById("play");
    this.pace = document.getElementById("pace");
    this.length = Math.max(clock.stop, report.duration ?? 0);
    this.slider.max = String(this.length);
    this.slider.disabled = this.button.disabled = clock.stop <= clock.start;
    document.getElementById("end").textContent = clockTime(this.length);
    this.slider.addEventListener("input", () => clock.seek(Number(this.slider.value)));
    this.button.addEventListener("click", () => clock.toggle());
    this.pace.addEventListener("change", () => clock.setPace(Number(this.pace.value)));
    clock.addEventListener("state", () => this.showState());
    this.addSpans();
    this.addMarks(open);
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

  /** Draw marks of the incidents that can be shown; collisions above the others. */
  addMarks(open) {
    const kinds = Object.keys(KINDS).reverse();
    const indices = this.report.incidents.map((_, index) => index).filter((index) => this.canShow(index));
    indices.sort((a, b) => kinds.indexOf(this.report.incidents[a].kind) - kinds.indexOf(this.report.incidents[b].kind));
    for (const index of indices) {
      const { kind, start, text } = this.report.incidents[index];
      const mark = element("button", "mark");
      mark.type = "button";
      mark.tabIndex = -1; // on the keyboard, incidents are chosen in the list
      mark.title = `${clockTime(start)} ${text}`;
      mark.setAttribute("aria-label", mark.title);
      mark.dataset.kind = kind;
      mark.style.left = this.share(start);
      mark.addEventListener("click", () => open(index));
      document.getElementById("marks").append(mark);
    }
  }

  canShow(index) {
    const { start } = this.report.incidents[index];
    return start !== null && this.clock.spans.some(([from, to]) => from <= start && start <= to);
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
