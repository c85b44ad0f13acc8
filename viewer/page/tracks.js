// The poses of all actors at a time: x, y in m, yaw in radians, right-handed.
"use strict";

/** Return the numbers in base64. */
function numbers(text, Type) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new Type(bytes.buffer);
}

/** Return the number of values of an ascending array that are at most a value. */
function countUntil(values, value) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return low;
}

const TURN = (2 * Math.PI) / 65536; // radians per unit of a sampled yaw
const SLOPE = 0.1; // s; speeds are measured over twice this time

class Tracks {
  constructor(recording) {
    this.times = numbers(recording.times, Float64Array);
    this.spans = recording.spans;
    this.actors = recording.actors;
    this.x = numbers(recording.x, Float32Array);
    this.y = numbers(recording.y, Float32Array);
    this.yaw = numbers(recording.yaw, Uint16Array);
    this.table = numbers(recording.tracks, Uint32Array);
    this.own = this.actors.map(() => []); // the tracks of each actor, in order of time
    for (let at = 0; at < this.table.length; at += 5) this.own[this.table[at]].push(at);
    this.byId = new Map();
    this.actors.forEach((actor, index) => {
      if (!this.byId.has(actor.id)) this.byId.set(actor.id, []);
      this.byId.get(actor.id).push(index);
    });
    this.readLights(recording.lights);
  }

  readLights(columns) {
    this.lights = new Map(); // actor → its changes
    const times = numbers(columns.time, Float64Array);
    const states = numbers(columns.state, Uint8Array);
    numbers(columns.actor, Uint32Array).forEach((actor, i) => {
      if (!this.lights.has(actor)) this.lights.set(actor, { times: [], states: [] });
      const light = this.lights.get(actor);
      light.times.push(times[i]);
      light.states.push(states[i]);
    });
  }

  /** Return the state of a traffic light, in CARLA's numbers. */
  lightState(actor, time) {
    const light = this.lights.get(actor);
    const count = light ? countUntil(light.times, time + 1e-4) : 0;
    return count ? light.states[count - 1] : null;
  }

  /** Return whether a time was sampled. */
  covers(time) {
    return this.spans.some(([start, stop]) => start <= time && time <= stop);
  }

  /** Return the sample at or before a time. */
  sampleAt(time) {
    return Math.max(0, countUntil(this.times, time) - 1);
  }

  /** Return the pose of an actor; false if it is absent. */
  pose(actor, time, sample, pose) {
    const { until } = this.actors[actor];
    if (until !== null && until <= time) return false;
    const at = this.trackAt(actor, sample);
    if (at < 0) return false;
    const single = this.table[at + 4] === 1;
    const row = this.table[at + 3] + (single ? 0 : sample - this.table[at + 1]);
    pose.x = this.x[row];
    pose.y = this.y[row];
    pose.yaw = this.yaw[row] * TURN;
    if (!single && sample < this.table[at + 2]) {
      const part = (time - this.times[sample]) / (this.times[sample + 1] - this.times[sample]);
      pose.x += part * (this.x[row + 1] - pose.x);
      pose.y += part * (this.y[row + 1] - pose.y);
      // Numbers of 16 bits overflow as angles do, so this is the shorter rotation.
      pose.yaw += part * (((this.yaw[row + 1] - this.yaw[row]) << 16) >> 16) * TURN;
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
      if (this.table[own[middle] + 1] <= sample) low = middle + 1;
      else high = middle;
    }
    return low && this.table[own[low - 1] + 2] >= sample ? own[low - 1] : -1;
  }

  /** Return the speed of an actor, in m/s. */
  speed(actor, time) {
    const [before, after] = [{}, {}];
    const [start, stop] = [Math.max(this.times[0], time - SLOPE), Math.min(this.times[this.times.length - 1], time + SLOPE)];
    const found =
      stop > start &&
      this.trackAt(actor, this.sampleAt(start)) >= 0 &&
      this.pose(actor, start, this.sampleAt(start), before) &&
      this.pose(actor, stop, this.sampleAt(stop), after);
    const speed = found ? Math.hypot(after.x - before.x, after.y - before.y) / (stop - start) : 0;
    return speed < 100 ? speed : 0; // a jump
  }

  /** Return the path of an actor in an interval, as lines of x, y, x, y, …, up to its end. */
  way(actor, start, stop) {
    const [from, to] = [this.sampleAt(start), this.sampleAt(stop)];
    const runs = [];
    for (const at of this.own[actor]) {
      const [, first, last, begin, length] = this.table.subarray(at, at + 5);
      if (length === 1 || last <= from || first > to) continue;
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
    const begun = indices.filter((index) => this.actors[index].since <= time + 1e-6);
    return begun.length ? begun[begun.length - 1] : indices.length ? indices[0] : -1;
  }
}
