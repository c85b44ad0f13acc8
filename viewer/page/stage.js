// Draws the scene from above.
"use strict";

const COLORS = {
  ground: "#14161c",
  grid: "#1b1e26",
  road: "#262a34",
  crossing: "#3a3f4c",
  line: "#545b6b",
  stop: "#aab1c0",
  text: "#e9ecf3",
  glass: "rgba(20, 22, 28, 0.62)",
};
const KINDS = {
  collision: { name: "Collision", many: "Collisions", color: "#ff5a5a", icon: "M4.5 4.5l7 7m0-7l-7 7" },
  "hard braking": { name: "Hard braking", many: "Hard braking", color: "#ffa24d", icon: "M4 4l4 4 4-4M4 8.5l4 4 4-4" },
  blocked: { name: "Blocked", many: "Blocked", color: "#b79cff", icon: "M5.5 4v8M10.5 4v8" },
};
const TRAIL = 3; // s
const LONG_TRAIL = 8; // s, of the followed actor
const NOTED = 1.5; // s before and after an incident in which it is marked
const SMALLEST = 7; // px
const ORDER = ["other", "sensor", "traffic sign", "traffic light", "walker", "vehicle"];
const REST = new Set(["other", "sensor", "traffic sign"]);

/** Lines of which only the visible ones are drawn. */
class Lines {
  constructor(runs, origin, closed = false) {
    this.runs = runs.filter((run) => run.length >= 4).map((run) => Lines.path(run, origin, closed));
  }

  static path(run, origin, closed) {
    const path = new Path2D();
    let [left, low, right, high] = [Infinity, Infinity, -Infinity, -Infinity];
    for (let i = 0; i < run.length; i += 2) {
      const [x, y] = [run[i], run[i + 1]];
      if (i) path.lineTo(x - origin.x, y - origin.y);
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

/** Return the lines of a layer of the map, each as x, y, x, y, … */
function layerRuns({ points, lengths }) {
  const [coordinates, runs] = [numbers(points, Float32Array), []];
  let begin = 0;
  for (const length of numbers(lengths, Uint32Array)) {
    runs.push(coordinates.subarray(begin, begin + 2 * length));
    begin += 2 * length;
  }
  return runs;
}

class Stage {
  constructor(canvas, tracks, camera, report, ground) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.tracks = tracks;
    this.camera = camera;
    this.report = report;
    this.labels = this.trails = true;
    this.hovered = -1;
    this.shown = []; // the drawn actors: { actor, x, y, yaw }
    this.origin = tracks.x.length ? { x: tracks.x[0], y: tracks.y[0] } : { x: 0, y: 0 };
    this.order = tracks.actors.map((_, index) => index).sort((a, b) => this.rank(a) - this.rank(b));
    this.build(ground);
  }

  rank(index) {
    const actor = this.tracks.actors[index];
    return ORDER.indexOf(actor.kind) + (actor.hero ? ORDER.length : 0);
  }

  build(ground) {
    const lines = (name, closed) => new Lines(layerRuns(ground[name]), this.origin, closed);
    this.laneWidth = ground.width;
    this.lanes = lines("lanes");
    this.junctions = lines("junctions", true);
    this.crossings = lines("crossings", true);
    this.borders = lines("borders");
    this.stops = lines("stops");
  }

  /** Return the rectangle around all roads, or around all actors if there are no roads. */
  get bounds() {
    const roads = this.lanes.bounds;
    if (roads[0] <= roads[2]) return roads;
    const places = this.shown.filter(({ actor }) => !REST.has(this.tracks.actors[actor].kind));
    const some = places.length ? places : this.shown.length ? this.shown : [{ x: 0, y: 0 }];
    const [xs, ys] = [some.map(({ x }) => x), some.map(({ y }) => y)];
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }

  /** Give the canvas the resolution of the screen. */
  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    this.ratio = Math.min(3, window.devicePixelRatio || 1);
    this.camera.width = clientWidth;
    this.camera.height = clientHeight;
    this.canvas.width = Math.max(1, Math.round(clientWidth * this.ratio));
    this.canvas.height = Math.max(1, Math.round(clientHeight * this.ratio));
  }

  draw(time) {
    const { context, camera } = this;
    this.time = time;
    this.sample = this.tracks.sampleAt(time);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = COLORS.ground;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    context.lineJoin = "round";
    this.place();
    camera.apply(context, this.ratio, this.origin);
    if (!this.borders.runs.length) this.drawGrid();
    this.drawRoads();
    if (this.trails) this.drawTrails();
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    for (const one of this.shown) this.drawActor(one);
    this.drawIncidents();
    if (this.labels) this.drawLabels();
  }

  /** Find the poses of all actors. */
  place() {
    const { tracks, camera, time, sample } = this;
    this.shown = [];
    for (const actor of this.order) {
      const pose = { actor };
      if (tracks.actors[actor].kind !== "sensor" && tracks.pose(actor, time, sample, pose)) {
        [pose.left, pose.top] = camera.toScreen(pose.x, pose.y);
        this.shown.push(pose);
      }
    }
  }

  drawGrid() {
    const { context, camera } = this;
    const step = [1, 5, 10, 50, 100, 500, 1000, 5000, 10000, 1e5, 1e6].find((metres) => metres * camera.scale > 36) ?? 1e7;
    const reach = camera.reach;
    context.beginPath();
    for (let x = Math.ceil((camera.x - reach) / step) * step; x < camera.x + reach; x += step) {
      context.moveTo(x - this.origin.x, camera.y - reach - this.origin.y);
      context.lineTo(x - this.origin.x, camera.y + reach - this.origin.y);
    }
    for (let y = Math.ceil((camera.y - reach) / step) * step; y < camera.y + reach; y += step) {
      context.moveTo(camera.x - reach - this.origin.x, y - this.origin.y);
      context.lineTo(camera.x + reach - this.origin.x, y - this.origin.y);
    }
    this.stroke(COLORS.grid, 1 / camera.scale);
    context.stroke();
  }

  drawRoads() {
    const { context, camera } = this;
    const fine = Math.max(0.13, 0.9 / camera.scale);
    context.lineCap = "round";
    this.stroke(COLORS.road, Math.max(this.laneWidth, 2 / camera.scale));
    for (const path of this.lanes.seen(camera)) context.stroke(path);
    context.fillStyle = COLORS.road;
    for (const path of this.junctions.seen(camera)) context.fill(path);
    if (camera.scale < 1) return;
    context.fillStyle = COLORS.crossing;
    for (const path of this.crossings.seen(camera)) context.fill(path);
    context.lineCap = "butt";
    this.stroke(COLORS.line, fine);
    for (const path of this.borders.seen(camera)) context.stroke(path);
    this.stroke(COLORS.stop, Math.max(0.35, fine));
    for (const path of this.stops.seen(camera)) context.stroke(path);
  }

  drawTrails() {
    const { context, tracks, camera, time } = this;
    context.lineCap = "butt";
    for (const { actor, x, y } of this.shown) {
      const { id, kind, color } = tracks.actors[actor];
      if (REST.has(kind) || kind === "traffic light") continue;
      const followed = id === camera.followed;
      const length = followed ? LONG_TRAIL : TRAIL;
      const run = tracks.way(actor, time - length, time).pop();
      if (!run) continue;
      run.push(x, y);
      const width = Math.max(kind === "walker" ? 0.3 : 0.6, (followed ? 2.5 : 1.5) / camera.scale);
      const points = run.length / 2;
      for (let i = 1; i < points; i++) {
        context.beginPath();
        context.moveTo(run[2 * i - 2] - this.origin.x, run[2 * i - 1] - this.origin.y);
        context.lineTo(run[2 * i] - this.origin.x, run[2 * i + 1] - this.origin.y);
        context.globalAlpha = (followed ? 0.75 : 0.4) * (i / points) ** 1.5;
        this.stroke(color, width);
        context.stroke();
      }
    }
    context.globalAlpha = 1;
  }

  drawActor({ actor, left, top, yaw }) {
    const { context, camera } = this;
    const { id, kind, color, box, hero } = this.tracks.actors[actor];
    const [middle, side, length, width] = box;
    const size = camera.scale * Math.max(length, width);
    if (Math.max(-left, -top, left - camera.width, top - camera.height) > size + 30) return;
    if (kind === "traffic light") {
      this.drawLamp(actor, left, top);
      return;
    }
    const least = REST.has(kind) ? 2 : SMALLEST;
    const scale = camera.scale * Math.max(1, least / 2 / size);
    const followed = id === camera.followed;
    context.save();
    context.translate(left, top);
    if (followed || hero || actor === this.hovered) {
      const glow = Math.max(size, SMALLEST) + 10;
      const shade = context.createRadialGradient(0, 0, glow * 0.4, 0, 0, glow);
      shade.addColorStop(0, color + "4d");
      shade.addColorStop(1, color + "00");
      context.fillStyle = shade;
      context.beginPath();
      context.arc(0, 0, glow, 0, 7);
      context.fill();
    }
    context.rotate(camera.up - UP - yaw);
    context.globalAlpha = REST.has(kind) ? 0.45 : 1;
    context.fillStyle = color;
    context.beginPath();
    if (kind === "walker") {
      context.arc(0, 0, Math.max(3, scale * Math.max(length, width)), 0, 7);
    } else {
      const corner = Math.min(length, width) * scale * 0.4;
      context.roundRect((middle - length) * scale, (-side - width) * scale, 2 * length * scale, 2 * width * scale, corner);
    }
    context.fill();
    if (followed || actor === this.hovered) {
      context.lineWidth = 1.5;
      context.strokeStyle = COLORS.text;
      context.stroke();
    }
    if (kind === "vehicle" && width * scale > 2.5) {
      context.fillStyle = COLORS.glass;
      const [left, top, long, wide] = [middle + 0.3 * length, -side - 0.8 * width, 0.32 * length, 1.6 * width];
      context.beginPath();
      context.roundRect(left * scale, top * scale, long * scale, wide * scale, 0.15 * wide * scale);
      context.fill();
    }
    context.restore();
  }

  drawLamp(actor, left, top) {
    const { context, camera } = this;
    const state = this.tracks.lightState(actor, this.time);
    const [, color] = this.report.lights[state] ?? this.report.lights[this.report.lights.length - 1];
    const radius = Math.min(7, Math.max(2, 0.7 * camera.scale));
    context.fillStyle = color + "33";
    context.beginPath();
    context.arc(left, top, radius * 2.4, 0, 7);
    context.fill();
    context.fillStyle = color;
    context.beginPath();
    context.arc(left, top, radius, 0, 7);
    context.fill();
  }

  /** Draw rings at the incidents around the present time. */
  drawIncidents() {
    const { context, camera, time } = this;
    for (const { kind, start, place } of this.report.incidents) {
      const late = time - start;
      if (!(Math.abs(late) < NOTED) || place[0] === null || place[1] === null) continue;
      const [left, top] = camera.toScreen(place[0], place[1]);
      const near = 1 - Math.abs(late) / NOTED;
      const radius = Math.max(14, 3.4 * camera.scale) * (late < 0 ? 1 + 0.6 * -late : 1);
      context.globalAlpha = near;
      context.lineWidth = 2;
      context.strokeStyle = KINDS[kind].color;
      context.fillStyle = KINDS[kind].color + "24";
      context.beginPath();
      context.arc(left, top, radius, 0, 7);
      context.fill();
      context.stroke();
      context.globalAlpha = 1;
    }
  }

  /** Draw names, the most important first; those that would overlap others are left out. */
  drawLabels() {
    const { context, camera, tracks } = this;
    const taken = [];
    const importance = ({ actor }) => {
      const { id, kind, hero } = tracks.actors[actor];
      if (actor === this.hovered) return 5;
      if (id === camera.followed) return 4;
      return hero ? 3 : kind === "vehicle" ? 2 : kind === "walker" ? 1 : 0;
    };
    context.font = "600 12px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
    context.textAlign = "center";
    context.lineWidth = 4;
    context.strokeStyle = COLORS.ground;
    context.fillStyle = COLORS.text;
    const named = this.shown.map((one) => ({ ...one, importance: importance(one) }));
    named.sort((a, b) => b.importance - a.importance);
    for (const { actor, left, top, importance } of named) {
      if (importance < (camera.scale > 3.5 ? 1 : 3)) break;
      if (left < -80 || top < -30 || left > camera.width + 80 || top > camera.height + 30) continue;
      const { label, box } = tracks.actors[actor];
      const bottom = top - Math.max(8, Math.max(box[2], box[3]) * camera.scale) - 8;
      const half = context.measureText(label).width / 2 + 4;
      const clashes = taken.some(([x, y, width]) => Math.abs(x - left) < width + half && Math.abs(y - bottom) < 15);
      if (clashes && importance < 4) continue;
      taken.push([left, bottom, half]);
      context.globalAlpha = importance > 3 ? 1 : 0.75;
      context.strokeText(label, left, bottom);
      context.fillText(label, left, bottom);
    }
    context.globalAlpha = 1;
  }

  /** Return the actor at a point of the screen, or -1. */
  actorAt(left, top) {
    let [nearest, least] = [-1, 18];
    for (const one of this.shown) {
      const { kind, box } = this.tracks.actors[one.actor];
      const reach = REST.has(kind) ? 6 : 0.6 * Math.max(box[2], box[3]) * this.camera.scale;
      const distance = Math.hypot(one.left - left, one.top - top) - reach + (REST.has(kind) ? 14 : 0);
      if (distance < least) [nearest, least] = [one.actor, distance];
    }
    return nearest;
  }

  stroke(color, width) {
    this.context.strokeStyle = color;
    this.context.lineWidth = width;
  }
}
