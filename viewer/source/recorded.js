// A recording in the page: what is known of it, the poses of its actors, and where it differs from another one.

import { countUntil } from "./data.js";
import { Motion } from "./motion.js";
import { Tracks } from "./tracks.js";

export const APART = 0.5; // m between two recordings of an actor that differ
export const LATE = 0.15; // s by which one recording may be behind the other
const ORDER = ["other", "sensor", "traffic sign", "traffic light", "walker", "vehicle"]; // of drawing

/** Return whether an actor is a vehicle or a walker. @param {Actor} actor */
export const moves = ({ kind }) => kind === "vehicle" || kind === "walker";

/** Return how important an actor is. @param {Actor} actor */
export const rank = ({ kind, hero }) => ORDER.indexOf(kind) + (hero ? ORDER.length : 0);

export class Recorded {
  /** @param {number} index @param {Report} report @param {RecordingData} data */
  constructor(index, report, data) {
    this.index = index;
    this.letter = "AB"[index];
    this.report = report;
    this.tracks = new Tracks(data);
    this.motion = new Motion(this.tracks, data.measured);
    const { actors } = this.tracks;
    this.order = actors.map((_, actor) => actor).sort((a, b) => rank(actors[a]) - rank(actors[b]));
    this.twins = /** @type {Map<number, number>} */ (new Map()); // the same actors of another recording
    const timed = report.incidents.flatMap((incident) => (incident.start === null ? [] : [{ incident, start: incident.start }]));
    this.timed = timed.sort((a, b) => a.start - b.start); // the incidents whose time is known, in order
    this.starts = this.timed.map(({ start }) => start);
  }

  /** Return the incidents that begin in an interval. @param {number} start @param {number} stop */
  incidentsIn(start, stop) {
    return this.timed.slice(countUntil(this.starts, start), countUntil(this.starts, stop));
  }

  /** Return the actor with an id at a time; null if none. @param {number | undefined} id @param {number} time */
  actor(id, time) {
    return this.tracks.actors[this.tracks.indexOf(id, time)] ?? null;
  }

  /** Return the pose of the actor with an id at a time; null if it is absent. @param {number} id @param {number} time */
  poseOf(id, time) {
    const [pose, index] = [{ x: 0, y: 0, yaw: 0 }, this.tracks.indexOf(id, time)];
    return index >= 0 && this.tracks.pose(index, time, this.tracks.sampleAt(time), pose) ? pose : null;
  }

  /** Return the actor of another recording that is the same as an actor of this one, or -1. @param {number} actor */
  twin(actor) {
    return this.twins.get(actor) ?? -1;
  }

  /** Return whether an incident of another recording happens in this one as well, at about the same time. @param {Incident} incident */
  has({ kind, start, types }) {
    const near = this.incidentsIn((start ?? NaN) - 1, (start ?? NaN) + 1);
    return near.some(({ incident }) => incident.kind === kind && incident.types.join() === types.join());
  }
}

/** Set the actors that two recordings have in common. @param {Recorded} first @param {Recorded} second */
export function pair(first, second) {
  for (const [id, since, otherId, otherSince] of first.report.differences?.pairs ?? []) {
    const [own, other] = [first.tracks.indexOf(id, since ?? 0), second.tracks.indexOf(otherId, otherSince ?? 0)];
    if (own < 0 || other < 0 || second.twins.has(other)) continue;
    first.twins.set(own, other);
    second.twins.set(other, own);
  }
}
