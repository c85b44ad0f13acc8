// Speed, acceleration and gap of the followed actor over time, with the present time as a line.
"use strict";

const WHOLE = 300; // s, the longest recording whose plots show all of it
const WINDOW = 120; // s, what the plots of a longer one show
const MOST_BRAKING = 12; // m/s², the largest acceleration in the plot
const HIGHEST = 250; // km/h
const ROWS = [
  { name: "Speed", unit: "km/h", of: "speed", factor: 3.6, digits: 0, least: 20 },
  { name: "Acceleration", unit: "m/s²", of: "acceleration", factor: 1, digits: 1, least: 4, signed: true },
  { name: "Gap ahead", unit: "m", of: "gap", factor: 1, digits: 1, least: 20 },
];

class Plots {
  /** seek: is called with a time. */
  constructor(recordings, length, seek) {
    this.recordings = recordings;
    this.length = length;
    this.frame = document.getElementById("plots");
    this.canvas = document.getElementById("plot");
    this.context = this.canvas.getContext("2d");
    this.readings = ROWS.map((row) => this.reading(row));
    this.followed = null;
    this.time = 0;
    this.base = document.createElement("canvas"); // all but the present time
    const move = (event) => {
      if (event.type === "pointerdown") this.canvas.setPointerCapture(event.pointerId);
      if (event.buttons & 1) seek(this.timeAt(event.offsetX));
    };
    this.canvas.addEventListener("pointerdown", move);
    this.canvas.addEventListener("pointermove", move);
    theme.addEventListener("change", () => this.refresh());
  }

  /** Add the name of a row and its values to the page, and return the elements of the values and of the note. */
  reading({ name, unit }) {
    const values = this.recordings.map(() => element("output"));
    const note = element("small");
    const cells = values.map((value, index) => element("span", `of-${this.recordings[index].letter}`, "", [value]));
    const parts = [element("dt", "", `${name} in ${unit}`), element("dd", "", "", [...cells, note])];
    document.getElementById("readings").append(element("div", "", "", parts));
    return { values, note };
  }

  get isOpen() {
    return !this.frame.hidden;
  }

  /** Use the room again, after it has changed. */
  refresh() {
    this.drawn = null;
    if (this.isOpen) this.draw(this.time, this.followed);
  }

  get span() {
    if (this.length <= WHOLE) return [0, Math.max(this.length, 0.1)];
    // It moves on in steps, so that the curves need not be drawn for each picture.
    const start = Math.round((this.time - WINDOW / 2) / 10) * 10;
    const begin = Math.max(0, Math.min(this.length - WINDOW, start));
    return [begin, begin + WINDOW];
  }

  /** The width of the curves, which is that of the timeline; the scales are beside them, where there is room. */
  get width() {
    return document.getElementById("marks").clientWidth || this.canvas.clientWidth;
  }

  /** Show on the timeline which part of a long recording the plots have. */
  showWindow(start, stop) {
    const part = document.getElementById("window");
    part.hidden = this.length <= WHOLE;
    part.style.left = `${(100 * start) / this.length}%`;
    part.style.width = `${(100 * (stop - start)) / this.length}%`;
  }

  timeAt(left) {
    const [start, stop] = this.span;
    return Math.min(stop, Math.max(start, start + (left / this.width) * (stop - start)));
  }

  /** Draw the plots of an actor, given by its id in each recording, with a line at a time. */
  draw(time, followed) {
    this.time = time;
    this.followed = followed;
    if (!this.isOpen) return;
    const { clientHeight: height } = this.canvas;
    const width = this.width;
    const [start, stop] = this.span;
    const found = this.recordings.map((recording) => {
      const actor = followed === null ? -1 : recording.tracks.indexOf(followed[recording.index], time);
      return { recording, actor, series: actor < 0 ? null : recording.motion.series(actor) };
    });
    const whole = this.canvas.clientWidth;
    this.showWindow(start, stop);
    const drawn = [whole, width, height, start, stop, ...found.map(({ actor }) => actor)].join();
    const ratio = Math.min(3, window.devicePixelRatio || 1);
    if (drawn !== this.drawn) {
      this.drawn = drawn;
      for (const canvas of [this.canvas, this.base]) {
        [canvas.width, canvas.height] = [Math.max(1, Math.round(whole * ratio)), Math.max(1, Math.round(height * ratio))];
      }
      this.drawBase(found, width, height, ratio);
    }
    const { context } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.drawImage(this.base, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawNow(found, width, height);
  }

  /** Return the colour of the curves of a recording. */
  color(recording) {
    return recording.index ? theme.colors.other : theme.colors.accent;
  }

  drawBase(found, width, height, ratio) {
    const context = this.base.getContext("2d");
    const { colors } = theme;
    const [start, stop] = this.span;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.clientWidth, height);
    this.rowHeight = (height - 18) / ROWS.length;
    const left = (time) => ((time - start) / (stop - start)) * width;
    this.drawTimes(context, start, stop, left, width, height);
    this.scales = ROWS.map((row, index) => {
      const scale = this.scale(row, found, start, stop);
      const [top, bottom] = [index * this.rowHeight + 5, (index + 1) * this.rowHeight - 4];
      const level = (value) => bottom - ((value - scale[0]) / (scale[1] - scale[0])) * (bottom - top);
      context.strokeStyle = colors.frame;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(0, Math.round(level(0)) + 0.5);
      context.lineTo(width, Math.round(level(0)) + 0.5);
      context.stroke();
      if (!index) this.drawIncidents(context, found, left, start, stop, height);
      for (const { recording, series } of [...found].reverse()) {
        if (series) this.drawCurve(context, row, series, this.color(recording), left, level, scale, [start, stop]);
      }
      context.font = `11px ${FONT}`;
      context.fillStyle = colors.quiet;
      const beside = this.canvas.clientWidth > width + 20;
      context.textAlign = beside ? "left" : "right";
      context.fillText(row.signed ? `±${scale[1]}` : `${scale[1]}`, beside ? width + 8 : width - 2, index * this.rowHeight + 13);
      return { level, scale };
    });
  }

  /** Draw lines at the incidents of the followed actor. */
  drawIncidents(context, found, left, start, stop, height) {
    context.lineWidth = 1.5;
    context.setLineDash([2, 3]);
    for (const { recording, actor } of found) {
      const { report, tracks } = recording;
      for (const { kind, start: time, actors } of actor < 0 ? [] : report.incidents) {
        if (time === null || time < start || time > stop || !actors.includes(tracks.actors[actor].id)) continue;
        context.strokeStyle = theme.tones[kind];
        context.beginPath();
        context.moveTo(left(time), 0);
        context.lineTo(left(time), height - 16);
        context.stroke();
      }
    }
    context.setLineDash([]);
  }

  drawTimes(context, start, stop, left, width, height) {
    const { colors } = theme;
    const step = [1, 2, 5, 10, 15, 30, 60].find((seconds) => left(start + seconds) > 64) ?? 60;
    context.font = `11px ${FONT}`;
    context.textAlign = "center";
    context.lineWidth = 1;
    for (let time = Math.ceil(start / step) * step; time <= stop; time += step) {
      context.strokeStyle = colors.frame;
      context.beginPath();
      context.moveTo(Math.round(left(time)) + 0.5, 0);
      context.lineTo(Math.round(left(time)) + 0.5, height - 16);
      context.stroke();
      context.fillStyle = colors.quiet;
      const x = left(time);
      if (x >= 0 && x < width - 14) context.fillText(clockTime(time, 0), Math.max(14, x), height - 4);
    }
  }

  /** Return the lowest and the highest value of a row. */
  scale({ of, factor, least, signed }, found, start, stop) {
    let most = 0;
    for (const { series } of found) {
      if (!series) continue;
      const [from, to] = [countUntil(series.times, start), countUntil(series.times, stop)];
      for (let i = from; i < to; i++) if (Math.abs(series[of][i]) > most) most = Math.abs(series[of][i]);
    }
    most = Math.max(least, Math.min(most * factor, signed ? MOST_BRAKING : HIGHEST));
    const top = [4, 6, 8, 10, 12, 20, 30, 40, 50, 60, 80, 100, 120, 160, 200, 250].find((value) => value >= most) ?? 250;
    return [signed ? -top : 0, top];
  }

  drawCurve(context, { of, factor, signed }, series, color, left, level, [low, high], [start, stop]) {
    const values = series[of];
    const { times } = series;
    const [from, to] = [Math.max(0, countUntil(times, start) - 1), Math.min(times.length, countUntil(times, stop) + 1)];
    const stride = Math.max(1, Math.floor((to - from) / 4000));
    context.strokeStyle = color;
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    const line = new Path2D();
    const area = new Path2D();
    let last = -1;
    for (let i = from; i < to; i += stride) {
      const value = Math.max(low, Math.min(high, values[i] * factor));
      const isGap = Number.isNaN(value) || (last >= 0 && times[i] - times[last] > 1);
      if (isGap && last >= 0) area.lineTo(left(times[last]), level(0));
      if (Number.isNaN(value)) {
        last = -1;
        continue;
      }
      if (last < 0 || isGap) {
        line.moveTo(left(times[i]), level(value));
        area.moveTo(left(times[i]), level(0));
      }
      line.lineTo(left(times[i]), level(value));
      area.lineTo(left(times[i]), level(value));
      last = i;
    }
    if (last >= 0) area.lineTo(left(times[last]), level(0));
    if (!signed) {
      context.globalAlpha = 0.12;
      context.fillStyle = color;
      context.fill(area);
    }
    context.globalAlpha = 1;
    context.stroke(line);
  }

  /** Draw the present time, the values at it, and the values. */
  drawNow(found, width, height) {
    const { context, time } = this;
    const { colors } = theme;
    const [start, stop] = this.span;
    const left = ((time - start) / (stop - start)) * width;
    context.strokeStyle = colors.text;
    context.lineWidth = 1;
    context.globalAlpha = 0.7;
    context.beginPath();
    context.moveTo(left, 0);
    context.lineTo(left, height - 16);
    context.stroke();
    context.globalAlpha = 1;
    ROWS.forEach((row, index) => {
      const { level, scale } = this.scales[index];
      const notes = [];
      found.forEach(({ recording, series, actor }, which) => {
        const value = series ? series[row.of][Math.max(0, countUntil(series.times, time + 1e-5) - 1)] * row.factor : NaN;
        const known = !Number.isNaN(value) && actor >= 0 && recording.tracks.covers(time);
        if (known) {
          context.fillStyle = this.color(recording);
          context.beginPath();
          context.arc(left, level(Math.max(scale[0], Math.min(scale[1], value))), 3.2, 0, 7);
          context.fill();
        }
        const number = Math.abs(value) < 0.05 ? 0 : value;
        write(this.readings[index].values[which], known ? number.toFixed(row.digits).replace("-", "−") : "–");
        if (known && row.of === "gap") notes.push(this.leader(recording, series, time));
        if (series && !series.isMeasured && row.of !== "speed") notes.push("not measured");
      });
      write(this.readings[index].note, [...new Set(notes)].filter(Boolean).join(", "));
    });
  }

  /** Return a note of what is ahead. */
  leader(recording, series, time) {
    const leader = series.leader[Math.max(0, countUntil(series.times, time + 1e-5) - 1)];
    return leader < 0 ? "" : `to ${recording.tracks.actors[leader].label}`;
  }
}

/** Set the text of an element, if it is another one. */
function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
