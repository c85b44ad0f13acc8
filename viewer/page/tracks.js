// The poses of all actors of a recording at a time: x, y in m, yaw in radians, right-handed.
"use strict";

const TURN = (2 * Math.PI) / 16384; // radians per unit of a sampled yaw

class Tracks {
  constructor(recording) {
    this.times = recording.times;
    this.spans = recording.spans;
    this.actors = recording.actors;
    this.x = recording.x;
    this.y = recording.y;
    this.yaw = recording.yaw;
    this.speeds = recording.speed;
    // One value for each track: its actor, its first and last sample, its first row, and the number of its rows.
    [this.owner, this.first, this.last, this.begin, this.count] = recording.tracks;
    this.own = this.actors.map(() => []); // the tracks of each actor, in order of time
    this.owner.forEach((actor, track) => this.own[actor].push(track));
    this.byId = new Map();
    this.actors.forEach((actor, index) => {
      if (!this.byId.has(actor.id)) this.byId.set(actor.id, []);
      this.byId.get(actor.id).push(index);
    });
    this.lights = changesOf(recording.lights.actor, recording.lights.time, recording.lights.state);
    this.falls = changesOf(recording.lying.actor, recording.lying.time, recording.lying.heading);
  }

  /** Return the state of a traffic light, in CARLA's numbers. */
  lightState(actor, time) {
    return latest(this.lights.get(actor), time);
  }

  /** Return the heading of the head of a walker that lies, in radians; null if it does not. */
  lying(actor, time) {
    const heading = latest(this.falls.get(actor), time);
    return heading === null || heading < 0 ? null : (heading * Math.PI) / 180;
  }

  /** Return whether a time was sampled. */
  covers(time) {
    return this.spans.some(([start, stop]) => start <= time && time <= stop);
  }

  /** Return the sample at or before a time. */
  sampleAt(time) {
    return Math.max(0, countUntil(this.times, time + 1e-5) - 1);
  }

  /** Return the pose of an actor; false if it is absent. */
  pose(actor, time, sample, pose) {
    const { until } = this.actors[actor];
    if (until !== null && until <= time) return false;
    const track = this.trackAt(actor, sample);
    if (track < 0) return false;
    const single = this.count[track] === 1;
    const row = this.begin[track] + (single ? 0 : sample - this.first[track]);
    pose.x = this.x[row];
    pose.y = this.y[row];
    pose.yaw = this.yaw[row] * TURN;
    if (!single && sample < this.last[track]) {
      const part = Math.max(0, time - this.times[sample]) / (this.times[sample + 1] - this.times[sample]);
      pose.x += part * (this.x[row + 1] - pose.x);
      pose.y += part * (this.y[row + 1] - pose.y);
      pose.yaw += part * (this.yaw[row + 1] - this.yaw[row]) * TURN; // within a track, it does not jump at a full turn
    }
    return true;
  }

  /** Return the track that continues at a sample, or else the one that ends at it. */
  trackAt(actor, sample) {
    const own = this.own[actor];
    let low = 0;
    let high = own.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.first[own[middle]] <= sample) low = middle + 1;
      else high = middle;
    }
    return low && this.last[own[low - 1]] >= sample ? own[low - 1] : -1;
  }

  /** Return the speed of an actor in m/s; NaN where it is unknown. */
  speed(actor, time) {
    const sample = this.sampleAt(time);
    const track = this.trackAt(actor, sample);
    if (track < 0) return NaN;
    const single = this.count[track] === 1;
    const speed = this.speeds[this.begin[track] + (single ? 0 : sample - this.first[track])];
    return speed < 0 ? NaN : speed;
  }

  /** Return the path of an actor in an interval, as lines of x, y, x, y, …, up to its end. */
  path(actor, start, stop) {
    const [from, to] = [this.sampleAt(start), this.sampleAt(stop)];
    const runs = [];
    for (const track of this.own[actor]) {
      const [first, last, begin] = [this.first[track], this.last[track], this.begin[track]];
      if (this.count[track] === 1 || last <= from || first > to) continue;
      const run = [];
      for (let i = Math.max(from, first); i <= Math.min(to, last); i++) {
        run.push(this.x[begin + i - first], this.y[begin + i - first]);
      }
      runs.push(run);
    }
    return runs;
  }

  /** Return the actor that has an id at a time, or the nearest one in time. */
  indexOf(id, time) {
    const indices = this.byId.get(id) ?? [];
    const begun = indices.filter((index) => this.actors[index].since <= time + 1e-4);
    return begun.length ? begun[begun.length - 1] : indices.length ? indices[0] : -1;
  }
}

/** Return the changes of each actor: the times, and what is from then on. */
function changesOf(actors, times, values) {
  const found = new Map();
  actors.forEach((actor, i) => {
    if (!found.has(actor)) found.set(actor, { times: [], values: [] });
    found.get(actor).times.push(times[i]);
    found.get(actor).values.push(values[i]);
  });
  return found;
}

/** Return what is at a time, by the changes of an actor; null before the first one. */
function latest(changes, time) {
  const count = changes ? countUntil(changes.times, time + 1e-4) : 0;
  return count ? changes.values[count - 1] : null;
}
