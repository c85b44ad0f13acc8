// What is plotted of an actor at each sample: its speed, its acceleration and the gap ahead.
"use strict";

const UNKNOWN_ACCELERATION = -127; // m/s²; below it, there is none

class Motion {
  constructor(tracks, measured) {
    this.tracks = tracks;
    this.measured = new Map(measured.map((each) => [each.id, each]));
    this.known = new Map(); // actor → its series
  }

  /**
   * Return times, speed (m/s), acceleration (m/s²), gap (m) and leader (an actor or -1) of an actor; NaN where unknown, and
   * whether more than its speed is measured.
   */
  series(actor) {
    if (!this.known.has(actor)) this.known.set(actor, this.measure(actor));
    return this.known.get(actor);
  }

  measure(actor) {
    const { tracks } = this;
    const { times } = tracks;
    const speed = this.speeds(actor);
    const measured = this.measured.get(tracks.actors[actor].id);
    const present = (sample) => measured && tracks.trackAt(actor, sample) >= 0;
    const values = (value) => Float64Array.from(times, (time, i) => (present(i) ? value(measured, time, i) : NaN));
    const acceleration = values(({ acceleration: all }, _, i) => (all[i] > UNKNOWN_ACCELERATION ? all[i] : NaN));
    const gap = values(({ headway }, _, i) => (headway[i] >= 0 ? headway[i] : NaN));
    const leader = Int32Array.from(times, (time, i) => (gap[i] >= 0 ? tracks.indexOf(measured.leader[i], time) : -1));
    return { times, speed, acceleration, gap, leader, isMeasured: Boolean(measured) };
  }

  /** Return the speeds of an actor at all samples; NaN if it is absent, or its speed unknown. */
  speeds(actor) {
    const { tracks } = this;
    const speed = new Float64Array(tracks.times.length).fill(NaN);
    for (const track of tracks.own[actor]) {
      const single = tracks.count[track] === 1;
      for (let i = tracks.first[track]; i <= tracks.last[track]; i++) {
        const value = tracks.speeds[tracks.begin[track] + (single ? 0 : i - tracks.first[track])];
        if (value >= 0) speed[i] = value;
      }
    }
    return speed;
  }
}
