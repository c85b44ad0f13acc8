// The time that is shown, and its progress.

import { countUntil } from "./data.js";

export class Clock extends EventTarget {
  /** spans: the intervals that can be shown, in order; moments: those of the samples, ascending. @param {Span[]} spans @param {number[]} moments */
  constructor(spans, moments) {
    super();
    this.spans = spans.length ? spans : [[0, 0]];
    this.stops = this.spans.map(([, stop]) => stop);
    this.moments = moments;
    this.start = this.spans[0][0];
    this.stop = this.spans[this.spans.length - 1][1];
    this.time = this.start;
    this.playing = false;
    this.pace = 1;
    this.goal = /** @type {number | null} */ (null); // the time at which to pause
    this.jumps = 0; // the number of jumps in time
  }

  /** Go to a time, or to the next one that can be shown. @param {number} time */
  seek(time) {
    this.time = this.nearest(Number.isFinite(time) ? time : this.start);
    this.goal = null;
    this.jumps++;
    this.dispatchEvent(new Event("seek"));
  }

  /** @param {number} time */
  nearest(time) {
    const span = this.spans[countUntil(this.stops, time - 1e-9)];
    return span ? Math.max(span[0], time) : this.stop;
  }

  /** Pause, and go some samples on, or with a negative number back. @param {number} count */
  step(count) {
    if (this.playing) this.pause();
    const before = countUntil(this.moments, this.time - 1e-4); // the number of samples before the present one
    const index = count > 0 ? countUntil(this.moments, this.time + 1e-4) + count - 1 : before + count;
    if (this.moments.length) this.seek(this.moments[Math.max(0, Math.min(this.moments.length - 1, index))]);
  }

  play() {
    if (this.stop <= this.start) return;
    if (this.time >= this.stop) this.seek(this.start);
    this.playing = true;
    this.dispatchEvent(new Event("state"));
  }

  /** Play from one time to another. @param {number} start @param {number} stop */
  playThrough(start, stop) {
    this.seek(start);
    this.goal = Math.min(stop, this.stop);
    if (this.time < this.goal) this.play();
  }

  pause() {
    this.playing = false;
    this.goal = null;
    this.dispatchEvent(new Event("state"));
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** @param {number} pace */
  setPace(pace) {
    this.pace = pace;
    this.dispatchEvent(new Event("state"));
  }

  /** Advance by some seconds. @param {number} seconds */
  tick(seconds) {
    const time = this.time + seconds * this.pace;
    const shown = this.nearest(time);
    if (shown > time) this.jumps++;
    this.time = this.goal === null ? shown : Math.min(shown, this.goal);
    if (this.time >= (this.goal ?? this.stop)) this.pause();
  }
}

/** Return the intervals of several lists as one list; those that overlap are joined. @param {Span[][]} lists */
export function merged(lists) {
  const all = /** @type {Span[]} */ ([]);
  for (const [start, stop] of lists.flat().sort((a, b) => a[0] - b[0])) {
    const last = all.at(-1);
    if (last && start <= last[1]) last[1] = Math.max(stop, last[1]);
    else all.push([start, stop]);
  }
  return all;
}

/** Return seconds as minutes and seconds: 1:02.5. @param {number} seconds */
export function clockTime(seconds, digits = 1) {
  const unit = 10 ** digits;
  const rounded = Math.round(seconds * unit) / unit;
  const minutes = Math.floor(rounded / 60);
  const rest = (rounded - minutes * 60).toFixed(digits).padStart(digits ? digits + 3 : 2, "0");
  if (minutes < 60) return `${minutes}:${rest}`;
  return `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
}
