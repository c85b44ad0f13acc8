// The time that is shown, and its progress.
"use strict";

class Clock extends EventTarget {
  /** spans: the intervals that can be shown, [start, stop] in seconds, in order. */
  constructor(spans) {
    super();
    this.spans = spans.length ? spans : [[0, 0]];
    this.start = this.spans[0][0];
    this.stop = this.spans[this.spans.length - 1][1];
    this.time = this.start;
    this.playing = false;
    this.pace = 1;
    this.goal = null; // the time at which to pause
    this.jumps = 0; // the number of jumps in time
  }

  /** Go to a time, or to the next one that can be shown. */
  seek(time) {
    this.time = this.nearest(Number.isFinite(time) ? time : this.start);
    this.goal = null;
    this.jumps++;
    this.dispatchEvent(new Event("seek"));
  }

  nearest(time) {
    for (const [start, stop] of this.spans) if (time <= stop) return Math.max(start, time);
    return this.stop;
  }

  play() {
    if (this.stop <= this.start) return;
    if (this.time >= this.stop) this.seek(this.start);
    this.playing = true;
    this.dispatchEvent(new Event("state"));
  }

  /** Play from one time to another. */
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

  setPace(pace) {
    this.pace = pace;
    this.dispatchEvent(new Event("state"));
  }

  /** Advance by some seconds. */
  tick(seconds) {
    const time = this.time + seconds * this.pace;
    const shown = this.nearest(time);
    if (shown > time) this.jumps++;
    this.time = this.goal === null ? shown : Math.min(shown, this.goal);
    if (this.time >= (this.goal ?? this.stop)) this.pause();
  }
}

/** Return the intervals of several lists as one list; those that overlap are joined. */
function merged(lists) {
  const all = [];
  for (const [start, stop] of lists.flat().sort((a, b) => a[0] - b[0])) {
    if (all.length && start <= all.at(-1)[1]) all.at(-1)[1] = Math.max(stop, all.at(-1)[1]);
    else all.push([start, stop]);
  }
  return all;
}

/** Return seconds as minutes and seconds: 1:02.5. */
function clockTime(seconds, digits = 1) {
  const unit = 10 ** digits;
  const rounded = Math.round(seconds * unit) / unit;
  const minutes = Math.floor(rounded / 60);
  const rest = (rounded - minutes * 60).toFixed(digits).padStart(digits ? digits + 3 : 2, "0");
  if (minutes < 60) return `${minutes}:${rest}`;
  return `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
}
