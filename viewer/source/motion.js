// What is plotted of an actor at each sample.

const UNKNOWN = -127; // below it, a measure is unknown

/** The measures of the page's data beside the speed: see `MeasuredActor` in samples.py. */
const MEASURES = ["acceleration", "gap", "ttc", "throttle", "brake", "steer", "light", "distance"];

export class Motion {
  /** @param {import("./tracks").Tracks} tracks @param {Measured[]} measured */
  constructor(tracks, measured) {
    this.tracks = tracks;
    this.measured = new Map(measured.map((each) => [each.id, each]));
    this.known = /** @type {Map<number, Series>} */ (new Map());
  }

  /** Return the speed (m/s) and the measures of an actor, NaN where unknown, its leader (an actor or -1), and whether more than
   * its speed is measured.
   * @param {number} actor */
  series(actor) {
    const known = this.known.get(actor) ?? this.measure(actor);
    this.known.set(actor, known);
    return known;
  }

  /** @param {number} actor @returns {Series} */
  measure(actor) {
    const { times } = this.tracks;
    const measured = this.measured.get(this.tracks.actors[actor].id);
    const speed = Float64Array.from(times, (_, sample) => this.tracks.speedAt(actor, sample));
    const present = Uint8Array.from(times, (_, sample) => (this.tracks.trackAt(actor, sample) < 0 ? 0 : 1));
    const values = /** @type {Record<string, Float64Array>} */ ({ speed });
    for (const name of MEASURES) {
      const all = measured?.[name];
      values[name] = Float64Array.from(times, (_, i) => (all && present[i] && all[i] > UNKNOWN ? all[i] : NaN));
    }
    const leader = Int32Array.from(times, (time, i) => (measured && values.gap[i] >= 0 ? this.tracks.indexOf(measured.leader[i], time) : -1));
    return { times, values, leader, isMeasured: measured !== undefined };
  }
}
