// The roads below the actors: the surfaces of a map, or the paths of vehicles.

import { theme } from "./theme.js";

/** The least scale, in px/m, at which a layer is drawn. @type {Record<string, number>} */
const FINE = { crossing: 1.2, white: 1.2, yellow: 1.2, bike: 0.5, median: 0.5 };

/** Lines of which only the visible ones are drawn. */
class Lines {
  /** sizes: the number of lines of each group that is drawn as one; without it, each line is drawn alone.
   * @param {LineData} data @param {{ x: number, y: number }} origin @param {Numbers | null} sizes */
  constructor({ x, y, lengths }, origin, sizes = null) {
    this.groups = /** @type {(Box & { path: Path2D, layer: string })[]} */ ([]);
    let [line, point] = [0, 0];
    const counts = sizes ?? new Uint8Array(lengths.length).fill(1);
    for (const count of counts) {
      const path = new Path2D();
      let [left, low, right, high] = [Infinity, Infinity, -Infinity, -Infinity];
      for (const end = line + count; line < end; line++) {
        for (let i = 0; i < lengths[line]; i++, point++) {
          const [a, b] = [x[point], y[point]];
          if (i) path.lineTo(a - origin.x, b - origin.y);
          else path.moveTo(a - origin.x, b - origin.y);
          [left, low, right, high] = [Math.min(left, a), Math.min(low, b), Math.max(right, a), Math.max(high, b)];
        }
        if (sizes) path.closePath();
      }
      this.groups.push({ path, left, low, right, high, layer: "" });
    }
  }
}

/** Return whether a camera sees a group. @param {Camera} camera @param {Box} group */
const sees = ({ x, y, reach }, { left, low, right, high }) => left < x + reach && right > x - reach && low < y + reach && high > y - reach;

export class Ground {
  /** origin: the point of the world that paths are relative to, since a canvas has few digits.
   * @param {GroundData} data @param {{ x: number, y: number }} origin */
  constructor({ width, paths, layers, layer, rings, surfaces }, origin) {
    this.origin = origin;
    this.width = width;
    this.paths = new Lines(paths, origin).groups;
    this.surfaces = new Lines(surfaces, origin, rings).groups;
    this.surfaces.forEach((group, i) => (group.layer = layers[layer[i]]));
  }

  /** The rectangle around everything: left, low, right, high. */
  get bounds() {
    return [...this.paths, ...this.surfaces].reduce(
      (all, one) => [Math.min(all[0], one.left), Math.min(all[1], one.low), Math.max(all[2], one.right), Math.max(all[3], one.high)],
      [Infinity, Infinity, -Infinity, -Infinity],
    );
  }

  /** Draw what a camera sees, in the axes of the world. @param {CanvasRenderingContext2D} context @param {Camera} camera */
  draw(context, camera) {
    const { colors } = theme;
    if (!this.surfaces.length) this.drawGrid(context, camera);
    context.lineJoin = context.lineCap = "round";
    context.strokeStyle = colors.road;
    context.lineWidth = Math.max(this.width, 2 / camera.scale);
    for (const group of this.paths) if (sees(camera, group)) context.stroke(group.path);
    context.lineWidth = 1.1 / camera.scale; // closes the seams between tiles
    context.lineJoin = "bevel";
    for (const group of this.surfaces) {
      if (camera.scale < (FINE[group.layer] ?? 0) || !sees(camera, group)) continue;
      context.fillStyle = context.strokeStyle = colors[group.layer === "junction" ? "road" : group.layer];
      context.fill(group.path);
      context.stroke(group.path);
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {Camera} camera */
  drawGrid(context, camera) {
    const step = [1, 5, 10, 50, 100, 500, 1000, 5000, 10000, 1e5, 1e6].find((metres) => metres * camera.scale > 36) ?? 1e7;
    const { reach } = camera;
    context.beginPath();
    const [left, low] = [camera.x - reach - this.origin.x, camera.y - reach - this.origin.y];
    for (let x = Math.ceil((camera.x - reach) / step) * step; x < camera.x + reach; x += step) context.rect(x - this.origin.x, low, 0, 2 * reach);
    for (let y = Math.ceil((camera.y - reach) / step) * step; y < camera.y + reach; y += step) context.rect(left, y - this.origin.y, 2 * reach, 0);
    context.strokeStyle = theme.colors.grid;
    context.lineWidth = 1 / camera.scale;
    context.stroke();
  }
}
