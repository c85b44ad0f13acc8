// The roads below the actors.
"use strict";

/** Lines of which only the visible ones are drawn. */
class Lines {
  constructor({ x, y, lengths }, origin, closed = false) {
    this.runs = [];
    let begin = 0;
    for (const length of lengths) {
      if (length > 1) this.runs.push(Lines.path(x, y, begin, begin + length, origin, closed));
      begin += length;
    }
  }

  static path(xs, ys, begin, end, origin, closed) {
    const path = new Path2D();
    let [left, low, right, high] = [Infinity, Infinity, -Infinity, -Infinity];
    for (let i = begin; i < end; i++) {
      const [x, y] = [xs[i], ys[i]];
      if (i > begin) path.lineTo(x - origin.x, y - origin.y);
      else path.moveTo(x - origin.x, y - origin.y);
      [left, low, right, high] = [Math.min(left, x), Math.min(low, y), Math.max(right, x), Math.max(high, y)];
    }
    if (closed) path.closePath();
    return { path, left, low, right, high };
  }

  *seen({ x, y, reach }) {
    for (const run of this.runs) {
      if (run.left < x + reach && run.right > x - reach && run.low < y + reach && run.high > y - reach) yield run.path;
    }
  }

  /** The rectangle around all lines: left, low, right, high. */
  get bounds() {
    return this.runs.reduce(
      (all, run) => [
        Math.min(all[0], run.left),
        Math.min(all[1], run.low),
        Math.max(all[2], run.right),
        Math.max(all[3], run.high),
      ],
      [Infinity, Infinity, -Infinity, -Infinity],
    );
  }
}

class Ground {
  /** origin: the point of the world that paths are relative to, since a canvas has few digits. */
  constructor(data, origin) {
    const lines = (name, closed) => new Lines(data[name], origin, closed);
    this.origin = origin;
    this.laneWidth = data.width;
    this.lanes = lines("lanes");
    this.junctions = lines("junctions", true);
    this.crossings = lines("crossings", true);
    this.borders = lines("borders");
    this.stops = lines("stops");
  }

  /** Draw what a camera sees, in the axes of the world. */
  draw(context, camera) {
    const { colors } = theme;
    const stroke = (color, width) => Object.assign(context, { strokeStyle: color, lineWidth: width });
    const fine = Math.max(0.14, 0.9 / camera.scale);
    if (!this.borders.runs.length) this.drawGrid(context, camera);
    context.lineJoin = context.lineCap = "round";
    stroke(colors.road, Math.max(this.laneWidth, 2 / camera.scale));
    for (const path of this.lanes.seen(camera)) context.stroke(path);
    context.fillStyle = colors.road;
    for (const path of this.junctions.seen(camera)) context.fill(path);
    if (camera.scale < 1) return;
    context.fillStyle = colors.crossing;
    for (const path of this.crossings.seen(camera)) context.fill(path);
    context.lineCap = "butt";
    stroke(colors.line, fine);
    for (const path of this.borders.seen(camera)) context.stroke(path);
    stroke(colors.stop, Math.max(0.35, fine));
    for (const path of this.stops.seen(camera)) context.stroke(path);
  }

  drawGrid(context, camera) {
    const step = [1, 5, 10, 50, 100, 500, 1000, 5000, 10000, 1e5, 1e6].find((metres) => metres * camera.scale > 36) ?? 1e7;
    const { reach } = camera;
    context.beginPath();
    for (let x = Math.ceil((camera.x - reach) / step) * step; x < camera.x + reach; x += step) {
      context.moveTo(x - this.origin.x, camera.y - reach - this.origin.y);
      context.lineTo(x - this.origin.x, camera.y + reach - this.origin.y);
    }
    for (let y = Math.ceil((camera.y - reach) / step) * step; y < camera.y + reach; y += step) {
      context.moveTo(camera.x - reach - this.origin.x, y - this.origin.y);
      context.lineTo(camera.x + reach - this.origin.x, y - this.origin.y);
    }
    context.strokeStyle = theme.colors.grid;
    context.lineWidth = 1 / camera.scale;
    context.stroke();
  }
}
