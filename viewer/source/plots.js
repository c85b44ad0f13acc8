// The followed actor over time, with the present time and that under the pointer as lines, and the values at it.

import { clockTime } from "./clock.js";
import { countUntil } from "./data.js";
import { byId, decimal, element, write } from "./elements.js";
import { zoomable } from "./part.js";
import { FONT } from "./stage.js";
import { theme } from "./theme.js";

/** @typedef {{ name: string, unit: string, of: string, digits: number, least: number, most: number, factor?: number, signed?: boolean,
 *   below?: string, always?: boolean, band?: boolean }} Row */
/** @typedef {{ recording: Recorded, actor: number, series: Series | null }} Found */

/** The rows: what is plotted, in which unit, up to which value at least and at most, and below the line; those that are not
 * always there are there if anything is known. @type {Row[]} */
const ROWS = [
  { name: "Speed", unit: "km/h", of: "speed", digits: 0, least: 20, most: 250, factor: 3.6, always: true },
  { name: "Acceleration", unit: "m/s²", of: "acceleration", digits: 1, least: 4, most: 12, signed: true, always: true },
  { name: "Throttle / brake", unit: "%", of: "throttle", below: "brake", digits: 0, least: 100, most: 100, factor: 100, signed: true },
  { name: "Steering", unit: "%", of: "steer", digits: 0, least: 20, most: 100, factor: 100, signed: true },
  { name: "Gap ahead", unit: "m", of: "gap", digits: 1, least: 20, most: 100, always: true },
  { name: "Time to collision", unit: "s", of: "ttc", digits: 1, least: 4, most: 10 },
  { name: "Light ahead", unit: "", of: "light", digits: 0, least: 1, most: 1, band: true },
];
const TOPS = [1, 4, 6, 8, 10, 12, 20, 30, 40, 50, 60, 80, 100, 120, 160, 200, 250];
const FOOT = 18; // px, for the times
const HALF_BAND = 5; // px

export class Plots {
  /** seek: is called with a time, and changed if another drawing is needed.
   * @param {Recorded[]} recordings @param {import("./part").Part} part
   * @param {{ seek: (time: number) => void, changed: () => void }} on */
  constructor(recordings, part, on) {
    this.recordings = recordings;
    this.part = part;
    this.frame = byId("plots");
    this.canvas = /** @type {HTMLCanvasElement} */ (byId("plot"));
    this.context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    this.base = document.createElement("canvas"); // all but the lines of times
    this.readings = ROWS.map((row) => this.reading(row));
    this.rows = ROWS;
    this.scales = /** @type {{ scale: number[], level: (value: number) => number }[]} */ ([]);
    this.drawn = "";
    this.time = 0;
    this.followed = /** @type {number[] | null} */ (null);
    this.pointed = /** @type {number | null} */ (null); // the time under the pointer
    zoomable(this.canvas, part, () => this.width, {
      drag: (right, down, left) => on.seek(part.timeAt(left / this.width)),
      hover: (left) => {
        this.pointed = left === null ? null : part.timeAt(left / this.width);
        on.changed();
      },
    });
    theme.addEventListener("change", () => this.refresh());
  }

  /** Add the name of a row and its values to the page, and return their elements. @param {Row} row */
  reading({ name, unit }) {
    const values = this.recordings.map(() => element("output"));
    const note = element("small");
    const cells = values.map((value, index) => element("span", `of-${this.recordings[index].letter}`, "", [value]));
    const node = element("div", "", "", [element("dt", "", name), element("dd", "", "", [...cells, element("small", "", unit), note])]);
    byId("readings").append(node);
    return { node, values, note };
  }

  get isOpen() {
    return !this.frame.hidden;
  }

  /** Use the room again, after it has changed. */
  refresh() {
    this.drawn = "";
    if (this.isOpen) this.draw(this.time, this.followed);
  }

  /** The width of the curves, which is that of the timeline; the scales are beside them, where there is room. */
  get width() {
    return byId("marks").clientWidth || this.canvas.clientWidth;
  }

  /** Draw the plots of an actor, given by its id in each recording, with a line at a time. @param {number} time @param {number[] | null} followed */
  draw(time, followed) {
    this.time = time;
    this.followed = followed;
    if (!this.isOpen) return;
    const found = this.recordings.map((recording) => {
      const actor = followed ? recording.tracks.indexOf(followed[recording.index], time) : -1;
      return { recording, actor, series: actor < 0 ? null : recording.motion.series(actor) };
    });
    const ratio = Math.min(3, window.devicePixelRatio || 1);
    const actors = found.map(({ actor }) => actor).join();
    const drawn = [this.canvas.clientWidth, this.canvas.clientHeight, this.width, this.part.start, this.part.stop, actors, ratio].join();
    if (drawn !== this.drawn) {
      this.showRows(found);
      this.drawn = drawn;
      for (const canvas of [this.canvas, this.base]) {
        canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
        canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
      }
      this.drawBase(found, ratio);
    }
    const { context } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.drawImage(this.base, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawLine(time, 0.7);
    if (this.pointed !== null) this.drawPointed(this.pointed);
    this.showValues(found, this.pointed ?? time);
  }

  /** Show the rows of which anything is known. @param {Found[]} found */
  showRows(found) {
    /** @param {Row} row */
    const known = ({ of, always }) => always || found.some(({ series }) => series?.values[of].some((value) => !Number.isNaN(value)));
    this.rows = ROWS.filter(known);
    ROWS.forEach((row, index) => (this.readings[index].node.hidden = !this.rows.includes(row)));
    this.frame.style.setProperty("--rows", String(this.rows.length));
  }

  /** Return the colour of the curves of a recording. @param {Recorded} recording */
  color(recording) {
    return recording.index ? theme.colors.other : theme.colors.accent;
  }

  /** @param {number} time */
  left(time) {
    return this.part.share(time) * this.width;
  }

  /** @param {Found[]} found @param {number} ratio */
  drawBase(found, ratio) {
    const context = /** @type {CanvasRenderingContext2D} */ (this.base.getContext("2d"));
    const { clientWidth, clientHeight: height } = this.canvas;
    const { colors } = theme;
    const width = this.width;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const high = (height - FOOT) / this.rows.length;
    const beside = clientWidth > width + 20; // else the values are above the curves
    this.drawTimes(context, height);
    context.save();
    context.beginPath();
    context.rect(0, 0, width, height);
    context.clip();
    this.scales = this.rows.map((row, index) => {
      const scale = this.scale(row, found);
      const [top, bottom] = [index * high + (beside ? 5 : 18), (index + 1) * high - 4];
      /** @param {number} value */
      const level = (value) => bottom - ((Math.max(scale[0], Math.min(scale[1], value)) - scale[0]) / (scale[1] - scale[0])) * (bottom - top);
      const zero = Math.round(row.band ? (top + bottom) / 2 : level(0)) + 0.5;
      line(context, colors.line, 0, zero, width, zero);
      if (!index) this.drawIncidents(context, found, height);
      for (const each of [...found].reverse()) {
        if (each.series && row.band) this.drawBand(context, each, (top + bottom) / 2);
        else if (each.series) this.drawCurve(context, row, each.recording, each.series, level);
      }
      return { level, scale };
    });
    context.restore();
    context.font = `11px ${FONT}`;
    context.fillStyle = colors.quiet;
    context.textAlign = beside ? "left" : "right";
    this.rows.forEach((row, index) => {
      const most = `${row.signed ? "±" : ""}${this.scales[index].scale[1]}`;
      if (!row.band) context.fillText(most, beside ? width + 8 : width - 2, index * high + 13);
    });
  }

  /** Draw lines at the incidents of the followed actor. @param {CanvasRenderingContext2D} context @param {Found[]} found @param {number} height */
  drawIncidents(context, found, height) {
    context.setLineDash([2, 3]);
    for (const { recording, actor } of found) {
      const id = recording.tracks.actors[actor]?.id;
      for (const { incident, start } of recording.incidentsIn(this.part.start - 1e-6, this.part.stop)) {
        if (!incident.actors.includes(id)) continue;
        line(context, theme.tones[incident.kind], this.left(start), 0, this.left(start), height - FOOT + 2, 1.5);
      }
    }
    context.setLineDash([]);
  }

  /** @param {CanvasRenderingContext2D} context @param {number} height */
  drawTimes(context, height) {
    const { start, stop } = this.part;
    const steps = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];
    const step = steps.find((seconds) => (seconds / (stop - start)) * this.width > 64) ?? 7200;
    context.font = `11px ${FONT}`;
    context.textAlign = "center";
    context.fillStyle = theme.colors.quiet;
    for (let number = Math.ceil(start / step - 1e-6); number * step <= stop; number++) {
      const x = this.left(number * step);
      line(context, theme.colors.line, Math.round(x) + 0.5, 0, Math.round(x) + 0.5, height - FOOT + 2);
      if (x < this.width - 14) context.fillText(clockTime(number * step, step < 1 ? 1 : 0), Math.max(step < 1 ? 18 : 14, x), height - 4);
    }
  }

  /** Return the lowest and the highest value of a row. @param {Row} row @param {Found[]} found */
  scale({ of, factor = 1, least, most, signed }, found) {
    let highest = 0;
    for (const { series } of found) {
      if (!series) continue;
      const [from, to] = [countUntil(series.times, this.part.start), countUntil(series.times, this.part.stop)];
      for (let i = from; i < to; i++) highest = Math.max(highest, Math.abs(series.values[of][i]) || 0);
    }
    const wanted = Math.max(least, Math.min(highest * factor, most));
    const top = TOPS.find((value) => value >= wanted - 1e-9) ?? wanted;
    return [signed ? -top : 0, top];
  }

  /** @param {Recorded} recording @param {(i: number, next: number) => void} visit is called with each sample of the part */
  eachSample({ tracks }, visit) {
    const { times } = tracks;
    const { start, stop } = this.part;
    const [from, to] = [Math.max(0, countUntil(times, start) - 1), Math.min(times.length, countUntil(times, stop) + 1)];
    for (let i = from; i < to; i++) visit(i, i + 1 < to && tracks.continues(i) ? i + 1 : -1);
  }

  /** Draw a curve, with the area to its line of zero: that of what is below the line, such as the brake, downwards.
   * @param {CanvasRenderingContext2D} context @param {Row} row @param {Recorded} recording @param {Series} series
   * @param {(value: number) => number} level */
  drawCurve(context, row, recording, series, level) {
    for (const { name, factor } of curves(row)) {
      const values = series.values[name];
      const [curve, area] = [new Path2D(), new Path2D()];
      let last = -1;
      this.eachSample(recording, (i, next) => {
        if (Number.isNaN(values[i])) return;
        const [x, y] = [this.left(series.times[i]), level(values[i] * factor)];
        if (last < 0) area.moveTo(x, level(0));
        if (last < 0) curve.moveTo(x, y);
        curve.lineTo(x, y);
        area.lineTo(x, y);
        last = next < 0 || Number.isNaN(values[next]) ? -1 : i;
        if (last < 0) area.lineTo(x, level(0));
      });
      context.fillStyle = context.strokeStyle = this.color(recording);
      context.globalAlpha = 0.12;
      if (!row.signed || row.below) context.fill(area);
      context.globalAlpha = 1;
      context.lineWidth = 1.6;
      context.lineJoin = "round";
      context.stroke(curve);
    }
  }

  /** Draw a band in the colours of the light ahead. @param {CanvasRenderingContext2D} context @param {Found} found @param {number} middle */
  drawBand(context, { recording, series }, middle) {
    const top = middle - HALF_BAND + (this.recordings.length > 1 ? (recording.index - 0.5) * 2 * HALF_BAND : 0);
    this.eachSample(recording, (i, next) => {
      const light = series?.values.light[i] ?? NaN;
      if (!series || Number.isNaN(light) || next < 0) return;
      context.fillStyle = recording.report.lights[light]?.[1] ?? theme.colors.quiet;
      const x = this.left(series.times[i]);
      context.fillRect(x, top, this.left(series.times[next]) - x + 0.5, 2 * HALF_BAND);
    });
  }

  /** @param {number} time @param {number} alpha */
  drawLine(time, alpha) {
    const x = this.left(time);
    this.context.globalAlpha = alpha;
    if (x >= 0 && x <= this.width) line(this.context, theme.colors.text, x, 0, x, this.canvas.clientHeight - FOOT + 2);
    this.context.globalAlpha = 1;
  }

  /** Draw a line at the time under the pointer, with the time below it. @param {number} time */
  drawPointed(time) {
    const { context } = this;
    this.drawLine(time, 0.4);
    context.font = `600 11px ${FONT}`;
    context.textAlign = "center";
    const [text, bottom] = [clockTime(time, 2), this.canvas.clientHeight];
    const half = context.measureText(text).width / 2 + 6;
    const x = Math.max(half, Math.min(this.width - half, this.left(time)));
    context.fillStyle = theme.colors.text;
    context.beginPath();
    context.roundRect(x - half, bottom - FOOT + 1, 2 * half, FOOT - 2, 4);
    context.fill();
    context.fillStyle = theme.colors.halo;
    context.fillText(text, x, bottom - 5);
  }

  /** Show the values at a time: as dots on the curves, and as numbers. @param {Found[]} found @param {number} time */
  showValues(found, time) {
    this.rows.forEach((row, index) => {
      const { values, note } = this.readings[ROWS.indexOf(row)];
      const notes = /** @type {string[]} */ ([]);
      found.forEach(({ recording, series }, which) => {
        const sample = series ? Math.max(0, countUntil(series.times, time + 1e-5) - 1) : 0;
        const known = series && recording.tracks.covers(time) && !Number.isNaN(series.values[row.of][sample]);
        if (series && !series.isMeasured && row.of !== "speed") notes.push("not measured");
        write(values[which], known ? this.text(row, recording, series, sample) : "–");
        if (!known) return;
        notes.push(this.note(row, recording, series, sample));
        for (const { name, factor } of curves(row)) {
          this.context.fillStyle = this.color(recording);
          this.context.beginPath();
          this.context.arc(this.left(time), this.scales[index].level(series.values[name][sample] * factor), 3.2, 0, 7);
          if (this.left(time) >= 0 && this.left(time) <= this.width) this.context.fill();
        }
      });
      write(note, [...new Set(notes)].filter(Boolean).join(", "));
    });
  }

  /** Return a value as a text. @param {Row} row @param {Recorded} recording @param {Series} series @param {number} sample */
  text({ of, below, factor = 1, digits, band }, recording, series, sample) {
    const value = series.values[of][sample];
    if (band) return recording.report.lights[value]?.[0] ?? "unknown";
    const text = decimal(of === "steer" ? Math.abs(value * factor) : value * factor, digits);
    return below ? `${text} / ${decimal(series.values[below][sample] * factor, digits)}` : text;
  }

  /** Return what is said beside a value. @param {Row} row @param {Recorded} recording @param {Series} series @param {number} sample */
  note({ of }, recording, series, sample) {
    if (of === "steer") return Math.abs(series.values.steer[sample]) < 0.005 ? "" : series.values.steer[sample] < 0 ? "left" : "right";
    if (of === "light") return Number.isNaN(series.values.distance[sample]) ? "" : `${decimal(series.values.distance[sample], 0)} m`;
    return of === "gap" && series.leader[sample] >= 0 ? `to ${recording.tracks.actors[series.leader[sample]].label}` : "";
  }
}

/** Return the curves of a row, and by what their values are multiplied. @param {Row} row */
function curves({ of, below, factor = 1, band }) {
  return band ? [] : [{ name: of, factor }, ...(below ? [{ name: below, factor: -factor }] : [])];
}

/** Draw a straight line. @param {CanvasRenderingContext2D} context @param {string} color @param {number} x0 @param {number} y0
 * @param {number} x1 @param {number} y1 @param {number} width */
function line(context, color, x0, y0, x1, y1, width = 1) {
  context.strokeStyle = color;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}
