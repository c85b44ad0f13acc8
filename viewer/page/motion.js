// The speed, the acceleration and the gap ahead of an actor, at each sample.
"use strict";

const ACCELERATION_SPAN = 0.3; // s before a moment over which an acceleration is the mean, as in scene/follow.py
const LONGEST_STEP = 1; // s; over a longer step there is no acceleration
const SIGHT = 60; // m; farther gaps are not shown
const PATH_STEP = 0.5; // m between points of a path
const CLEARANCE = 0.2; // m beside an actor that counts as its width

class Motion {
  constructor(tracks) {
    this.tracks = tracks;
    this.known = new Map(); // actor → its series
  }

  /** Return times, speed (m/s), acceleration (m/s²), gap (m) and leader (an actor or -1) of an actor; NaN where unknown. */
  series(actor) {
    if (!this.known.has(actor)) this.known.set(actor, this.measure(actor));
    return this.known.get(actor);
  }

  measure(actor) {
    const { times } = this.tracks;
    const { x, y, yaw, speed } = this.rows(actor);
    return { times, speed, acceleration: accelerations(times, speed), ...this.gaps(actor, x, y, yaw) };
  }

  /** Return the poses and speeds of an actor at all samples; NaN if it is absent, or its speed unknown. */
  rows(actor) {
    const { tracks } = this;
    const count = tracks.times.length;
    const [x, y, yaw, speed] = [0, 0, 0, 0].map(() => new Float64Array(count).fill(NaN));
    for (const track of tracks.own[actor]) {
      const single = tracks.count[track] === 1;
      for (let i = tracks.first[track]; i <= tracks.last[track]; i++) {
        const row = tracks.begin[track] + (single ? 0 : i - tracks.first[track]);
        [x[i], y[i], yaw[i]] = [tracks.x[row], tracks.y[row], tracks.yaw[row] * TURN];
        if (tracks.speeds[row] >= 0) speed[i] = tracks.speeds[row];
      }
    }
    return { x, y, yaw, speed };
  }

  /** Return the gap between the bumpers to the nearest actor on the path that an actor drives. */
  gaps(actor, x, y, yaw) {
    const { tracks } = this;
    const count = tracks.times.length;
    const gap = new Float32Array(count).fill(NaN);
    const leader = new Int32Array(count).fill(-1);
    const { kind, box } = tracks.actors[actor];
    if (kind !== "vehicle") return { gap, leader };
    const path = new DrivenPath(x, y, yaw);
    const front = box[0] + box[2];
    tracks.actors.forEach((other, index) => {
      if (index === actor || (other.kind !== "vehicle" && other.kind !== "walker")) return;
      const [middle, , length, width] = other.box;
      for (const track of tracks.own[index]) {
        const single = tracks.count[track] === 1;
        const begin = tracks.begin[track];
        for (let i = tracks.first[track]; i <= tracks.last[track]; i++) {
          const row = begin + (single ? 0 : i - tracks.first[track]);
          const [otherX, otherY] = [tracks.x[row], tracks.y[row]];
          if (!(Math.abs(otherX - x[i]) < SIGHT + 10 && Math.abs(otherY - y[i]) < SIGHT + 10)) continue;
          const widest = box[3] + Math.hypot(length, width) + CLEARANCE;
          const met = path.nearest(i, otherX, otherY, SIGHT + front + length, widest);
          if (!met) continue;
          const turn = tracks.yaw[row] * TURN - met.heading;
          const [cosine, sine] = [Math.abs(Math.cos(turn)), Math.abs(Math.sin(turn))];
          const [along, across] = [cosine * length + sine * width, sine * length + cosine * width];
          if (met.distance > box[3] + across + CLEARANCE) continue;
          const free = Math.max(0, met.ahead + Math.cos(turn) * middle - along - front);
          if (free < SIGHT && !(gap[i] <= free)) [gap[i], leader[i]] = [free, index];
        }
      }
    });
    return { gap, leader };
  }
}

/** Return the mean acceleration over the last moments at each sample where speeds are known. */
function accelerations(times, speed) {
  const found = new Float32Array(times.length).fill(NaN);
  const known = [];
  for (let i = 0; i < times.length; i++) if (!Number.isNaN(speed[i])) known.push(i);
  let first = 0;
  for (let at = 1; at < known.length; at++) {
    while (times[known[first]] < times[known[at]] - ACCELERATION_SPAN - 1e-5) first++;
    const from = known[Math.min(first, at - 1)];
    const seconds = times[known[at]] - times[from];
    if (seconds > 0 && seconds <= LONGEST_STEP) found[known[at]] = (speed[known[at]] - speed[from]) / seconds;
  }
  return found;
}

/** The path that an actor drives, continued straight on at its end. */
class DrivenPath {
  constructor(x, y, yaw) {
    this.x = [];
    this.y = [];
    this.heading = [];
    this.along = []; // m from the start
    this.at = new Int32Array(x.length); // the point of the path at each sample
    let length = 0;
    let last = -1;
    for (let i = 0; i < x.length; i++) {
      this.at[i] = Math.max(0, this.x.length - 1);
      if (Number.isNaN(x[i])) continue;
      const step = last < 0 ? Infinity : Math.hypot(x[i] - this.x[this.x.length - 1], y[i] - this.y[this.y.length - 1]);
      if (step < PATH_STEP) continue;
      if (last >= 0) length += step;
      last = i;
      this.add(x[i], y[i], yaw[i], length);
      this.at[i] = this.x.length - 1;
    }
    if (last < 0) return;
    const end = this.x.length - 1;
    const [startX, startY, heading] = [this.x[end], this.y[end], this.heading[end]];
    for (let metres = 1; metres < SIGHT + 10; metres++) {
      this.add(startX + metres * Math.cos(heading), startY + metres * Math.sin(heading), heading, length + metres);
    }
  }

  add(x, y, heading, along) {
    this.x.push(x);
    this.y.push(y);
    this.heading.push(heading);
    this.along.push(along);
  }

  /**
   * Return the distance and the heading of the path where it is first nearest to a point ahead of a sample; null if it is
   * nowhere nearer than a limit.
   */
  nearest(sample, x, y, reach, limit) {
    const start = this.at[sample];
    let [distance, at] = [Infinity, -1];
    for (let k = start; k < this.x.length && this.along[k] - this.along[start] < reach; ) {
      const here = Math.hypot(x - this.x[k], y - this.y[k]);
      if (here < distance) [distance, at] = [here, k];
      else if (distance <= limit && here > limit + PATH_STEP) break;
      const skipped = here - limit - PATH_STEP; // up to there, the path is not near enough
      const from = this.along[k++];
      while (k < this.x.length && this.along[k] - from < skipped) k++;
    }
    if (at <= start || distance > limit + PATH_STEP) return null;
    const heading = this.heading[at];
    const offset = (x - this.x[at]) * Math.cos(heading) + (y - this.y[at]) * Math.sin(heading);
    const lateral = Math.abs((y - this.y[at]) * Math.cos(heading) - (x - this.x[at]) * Math.sin(heading));
    const far = Math.max(0, Math.abs(offset) - 2 * PATH_STEP);
    return { distance: Math.hypot(lateral, far), heading, ahead: this.along[at] - this.along[start] + offset };
  }
}
