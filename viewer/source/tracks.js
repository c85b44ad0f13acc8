// The poses of all actors of a recording at a time: x, y in m, yaw in radians, right-handed.

import { countUntil } from "./data.js";

const TURN = (2 * Math.PI) / 16384; // radians per unit of a sampled yaw

export class Tracks {
  /** @param {RecordingData} recording */
  constructor(recording) {
    this.times = recording.times;
    this.spans = recording.spans;
    this.starts = this.spans.map(([start]) => start);
    this.ends = new Set(this.starts.map((start) => countUntil(this.times, start - 1e-4) - 1)); // the last sample before each
    this.actors = recording.actors;
    this.x = recording.x;
    this.y = recording.y;
    this.yaw = recording.yaw;
    this.speeds = recording.speed;
    // One value for each track: its actor, its first and last sample, its first row, and the number of its rows.
    const [owner, first, last, begin, count] = recording.tracks;
    this.first = first;
    this.last = last;
    this.begin = begin;
    this.count = count;
    this.own = this.actors.map(() => /** @type {number[]} */ ([])); // the tracks of each actor, in order of time
    owner.forEach((actor, track) => this.own[actor].push(track));
    this.firsts = this.own.map((tracks) => tracks.map((track) => this.first[track]));
    /** @type {Map<number, { indices: number[], since: number[] }>} */
    this.byId = new Map(); // the actors that have an id one after the other, and since when
    this.actors.forEach(({ id, since }, index) => {
      const lives = this.byId.get(id) ?? { indices: [], since: [] };
      this.byId.set(id, lives);
      lives.indices.push(index);
      lives.since.push(since ?? 0);
    });
    this.lights = changesOf(recording.lights);
    this.falls = changesOf(recording.lying);
    this.lamps = changesOf(recording.lamps);
    this.marks = recording.marks;
    this.marked = this.marks.map(([since]) => since);
  }

  /** Return the state of a traffic light, in CARLA's numbers. @param {number} actor @param {number} time */
  lightState(actor, time) {
    return latest(this.lights.get(actor), time);
  }

  /** Return the heading of the head of a walker that lies, in radians; null if it does not. @param {number} actor @param {number} time */
  lying(actor, time) {
    const heading = latest(this.falls.get(actor), time);
    return heading === null || heading < 0 ? null : (heading * Math.PI) / 180;
  }

  /** Return the lit lamps of a vehicle, as bits of CARLA's VehicleLightState. @param {number} actor @param {number} time */
  lampsOf(actor, time) {
    return latest(this.lamps.get(actor), time) ?? 0;
  }

  /** Return where marks of collisions are. @param {number} time */
  marksAt(time) {
    return this.marks[countUntil(this.marked, time + 1e-4) - 1]?.[1] ?? [];
  }

  /** Return whether a time was sampled. @param {number} time */
  covers(time) {
    const span = this.spans[countUntil(this.starts, time) - 1];
    return span !== undefined && time <= span[1];
  }

  /** Return the sample at or before a time. @param {number} time */
  sampleAt(time) {
    return Math.max(0, countUntil(this.times, time + 1e-5) - 1);
  }

  /** Write the pose of an actor into an object, and return whether it is present.
   * @param {number} actor @param {number} time @param {number} sample @param {Pose} pose */
  pose(actor, time, sample, pose) {
    const { until } = this.actors[actor];
    if (until !== null && until <= time) return false;
    const track = this.trackAt(actor, sample);
    if (track < 0) return false;
    const row = this.row(track, sample);
    pose.x = this.x[row];
    pose.y = this.y[row];
    pose.yaw = this.yaw[row] * TURN;
    if (this.count[track] > 1 && sample < this.last[track]) {
      const part = Math.max(0, time - this.times[sample]) / (this.times[sample + 1] - this.times[sample]);
      pose.x += part * (this.x[row + 1] - pose.x);
      pose.y += part * (this.y[row + 1] - pose.y);
      pose.yaw += part * (this.yaw[row + 1] - this.yaw[row]) * TURN; // within a track, it does not jump at a full turn
    }
    return true;
  }

  /** Return the track that continues at a sample, or else the one that ends at it; -1 if none. @param {number} actor @param {number} sample */
  trackAt(actor, sample) {
    const track = this.own[actor][countUntil(this.firsts[actor], sample) - 1];
    return track !== undefined && this.last[track] >= sample ? track : -1;
  }

  /** Return the row of a sample of a track; one of an actor that stands still has a single one. @param {number} track @param {number} sample */
  row(track, sample) {
    return this.begin[track] + (this.count[track] === 1 ? 0 : sample - this.first[track]);
  }

  /** Return the speed of an actor at a sample in m/s; NaN where it is unknown. @param {number} actor @param {number} sample */
  speedAt(actor, sample) {
    const track = this.trackAt(actor, sample);
    const speed = track < 0 ? -1 : this.speeds[this.row(track, sample)];
    return speed < 0 ? NaN : speed;
  }

  /** @param {number} actor @param {number} time */
  speed(actor, time) {
    return this.speedAt(actor, this.sampleAt(time));
  }

  /** Return the path of an actor in an interval, as lines of x, y, x, y, …, up to its end, without its jumps.
   * @param {number} actor @param {number} start @param {number} stop */
  path(actor, start, stop) {
    const [from, to] = [this.sampleAt(start), this.sampleAt(stop)];
    const runs = /** @type {number[][]} */ ([]);
    let before = -1; // the last sample of the track before, which the next one begins with unless the actor has jumped
    for (const track of this.own[actor]) {
      const [first, last] = [this.first[track], this.last[track]];
      if (last >= from && first <= to) {
        if (first !== before || !runs.length) runs.push([]);
        for (let sample = Math.max(from, first); sample <= Math.min(to, last); sample++) {
          const [run, row] = [runs[runs.length - 1], this.row(track, sample)];
          if (this.x[row] !== run[run.length - 2] || this.y[row] !== run[run.length - 1]) run.push(this.x[row], this.y[row]);
        }
      }
      before = last;
    }
    return runs;
  }

  /** Return whether a sample and the one after it are of one span. @param {number} sample */
  continues(sample) {
    return sample + 1 < this.times.length && !this.ends.has(sample);
  }

  /** Return the actor that has an id at a time, or else the first one that has it; -1 if none.
   * @param {number | null | undefined} id @param {number} time */
  indexOf(id, time) {
    const lives = this.byId.get(id ?? -1);
    return lives ? lives.indices[Math.max(0, countUntil(lives.since, time + 1e-4) - 1)] : -1;
  }
}

/** Return the changes of each actor: the times, and what is from then on. @param {Changes} changes */
function changesOf({ actor: actors, time, value }) {
  const found = /** @type {Map<number, { times: number[], values: number[] }>} */ (new Map());
  actors.forEach((actor, i) => {
    const own = found.get(actor) ?? { times: [], values: [] };
    found.set(actor, own);
    own.times.push(time[i]);
    own.values.push(value[i]);
  });
  return found;
}

/** Return what is at a time, by the changes of an actor; null before the first one.
 * @param {{ times: number[], values: number[] } | undefined} changes @param {number} time */
function latest(changes, time) {
  const count = changes ? countUntil(changes.times, time + 1e-4) : 0;
  return changes && count ? changes.values[count - 1] : null;
}
