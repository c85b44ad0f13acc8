// A recording in the page: what is known of it, the poses of its actors, and where it differs from another one.
"use strict";

const APART = 0.5; // m between two recordings of an actor that differ
const LATE = 0.15; // s by which one recording may be behind the other
const SAME_SPOT = 3; // m
const DIFFERENCE_STEP = 0.1; // s
const MOST_STEPS = 3000;

class Recorded {
  constructor(index, report, data) {
    this.index = index;
    this.letter = "AB"[index];
    this.report = report;
    this.tracks = new Tracks(data);
    this.motion = new Motion(this.tracks, data.measured);
    const rank = ({ kind, hero }) => ORDER.indexOf(kind) + (hero ? ORDER.length : 0);
    const { actors } = this.tracks;
    this.order = actors.map((_, actor) => actor).sort((a, b) => rank(actors[a]) - rank(actors[b]));
  }

  /** Return the actor with an id at a time; null if none. */
  actor(id, time) {
    return this.tracks.actors[this.tracks.indexOf(id, time)] ?? null;
  }

  /** Return the pose of the actor with an id at a time; null if it is absent. */
  poseOf(id, time) {
    const [pose, index] = [{}, this.tracks.indexOf(id, time)];
    return index >= 0 && this.tracks.pose(index, time, this.tracks.sampleAt(time), pose) ? pose : null;
  }

  /** Return the actor of another recording that is the same as an actor of this one, or -1. */
  twin(actor) {
    return this.twins?.get(actor) ?? -1;
  }

  /** Return since when vehicles and walkers move differently than in another recording; null if they do not. */
  differsFrom(other) {
    const stop = Math.min(this.tracks.times.at(-1) ?? 0, other.tracks.times.at(-1) ?? 0);
    const [a, b] = [{}, {}];
    const step = Math.max(DIFFERENCE_STEP, stop / MOST_STEPS);
    for (let time = 0; time <= stop + 1e-6; time += step) {
      if (!this.tracks.covers(time) || !other.tracks.covers(time)) continue;
      const samples = [this.tracks.sampleAt(time), other.tracks.sampleAt(time)];
      for (const [own, twin] of this.twins) {
        const both = this.tracks.pose(own, time, samples[0], a) && other.tracks.pose(twin, time, samples[1], b);
        const tolerance = both && APART + LATE * this.tracks.speed(own, time);
        if (both && Math.hypot(a.x - b.x, a.y - b.y) > tolerance) return time;
      }
    }
    return null;
  }

  /** Return whether an incident of another recording happens in this one as well, at about the same time. */
  has({ kind, start, types }) {
    const same = (one) => one.kind === kind && Math.abs(one.start - start) < 1 && one.types.join() === types.join();
    return this.report.incidents.some(same);
  }
}

/** Set the actors that two recordings have in common: the given ones, or else those that look the same. */
function pair(first, second) {
  [first.twins, second.twins] = [new Map(), new Map()];
  const { differences } = first.report;
  if (!differences) return findPairs(first, second);
  for (const [id, since, otherId, otherSince] of differences.pairs) {
    const [own, other] = [first.tracks.indexOf(id, since ?? 0), second.tracks.indexOf(otherId, otherSince ?? 0)];
    if (own < 0 || other < 0 || second.twins.has(other)) continue;
    first.twins.set(own, other);
    second.twins.set(other, own);
  }
}

/** Find the vehicles and walkers that two recordings have in common: of the same type, first seen in the same spot. */
function findPairs(first, second) {
  const moves = ({ kind }) => kind === "vehicle" || kind === "walker";
  const [own, other] = [{}, {}];
  first.tracks.actors.forEach((actor, index) => {
    if (!moves(actor) || !first.tracks.own[index].length) return;
    const time = first.tracks.times[first.tracks.first[first.tracks.own[index][0]]];
    const samples = [first, second].map(({ tracks }) => tracks.sampleAt(time));
    if (!first.tracks.pose(index, time, samples[0], own)) return;
    let [best, least] = [-1, Infinity];
    second.tracks.actors.forEach((candidate, at) => {
      if (candidate.type !== actor.type || second.twins.has(at)) return;
      const isThere = second.tracks.pose(at, time, samples[1], other);
      const distance = isThere ? Math.hypot(own.x - other.x, own.y - other.y) : Infinity;
      const rank = (candidate.hero && actor.hero ? -2 : 0) + distance / SAME_SPOT - (candidate.id === actor.id ? 0.1 : 0);
      if (rank < least && (distance < SAME_SPOT || (candidate.hero && actor.hero))) [best, least] = [at, rank];
    });
    if (best < 0) return;
    first.twins.set(index, best);
    second.twins.set(best, index);
  });
}
