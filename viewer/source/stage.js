// Draws the scene from above: the roads, and the actors of one recording or, over each other, of two.

import { UP } from "./camera.js";
import { APART, LATE, moves } from "./recorded.js";
import { BODY, DETAILED, details, outline, visible } from "./shapes.js";
import { theme } from "./theme.js";

const TRAIL = 3; // s
const FAST = 40; // m/s; trails of what is farther outside the view do not reach it
const FADES = 16; // parts of a trail
const LONG_TRAIL = 8; // s, of the followed actor
const NOTED = 1.5; // s before and after an incident in which it is marked
const SMALLEST = 7; // px
const REST = new Set(["other", "sensor", "traffic sign"]);
export const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif";

export class Stage {
  /** recordings: the one to show, or two to show over each other.
   * @param {HTMLCanvasElement} canvas @param {Recorded[]} recordings @param {Camera} camera
   * @param {import("./ground").Ground} ground */
  constructor(canvas, recordings, camera, ground) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    this.camera = camera;
    this.ground = ground;
    this.origin = ground.origin;
    this.labels = this.trails = true;
    this.marks = true; // whether incidents are marked
    this.hovered = -1;
    this.ratio = 1;
    this.time = 0;
    this.recording = recordings[0];
    this.ghost = recordings.at(1);
    this.shown = /** @type {Drawn[]} */ ([]); // the drawn actors
    this.ghosts = /** @type {Drawn[]} */ ([]); // those of the other recording
    this.places = /** @type {Map<number, Drawn>} */ (new Map()); // the drawn actors by index
  }

  /** @param {Recorded[]} recordings */
  show(recordings) {
    [this.recording, this.ghost] = recordings;
    this.shown = this.ghosts = [];
  }

  get tracks() {
    return this.recording.tracks;
  }

  /** Return the rectangle around all roads, or around all actors if there are no roads. */
  get bounds() {
    const roads = this.ground.bounds;
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

  /** @param {number} time */
  draw(time) {
    const { context, camera } = this;
    this.time = time;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.globalAlpha = 1;
    context.fillStyle = theme.colors.map;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.shown = this.locate(this.recording);
    this.places = new Map(this.shown.map((one) => [one.actor, one]));
    const { ghost } = this;
    this.ghosts = ghost ? this.locate(ghost).filter((one) => this.differs(ghost, one)) : [];
    camera.apply(context, this.ratio, this.origin);
    this.ground.draw(context, camera);
    if (this.trails) this.drawTrails();
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (this.marks) this.drawCollisions();
    for (const one of this.ghosts) this.drawGhost(/** @type {Recorded} */ (ghost), one);
    for (const one of this.shown) this.drawActor(one);
    const followed = this.places.get(this.tracks.indexOf(camera.followed, this.time));
    if (followed) this.drawActor(followed); // above what may hide it
    if (this.ghosts.length) this.drawDistance();
    if (this.marks) this.drawIncidents();
    if (this.labels) this.drawLabels();
  }

  /** Return the poses of the present actors of a recording. @param {Recorded} recording */
  locate({ tracks, order }) {
    const sample = tracks.sampleAt(this.time);
    const found = [];
    for (const actor of order) {
      const pose = { actor, x: 0, y: 0, yaw: 0, left: 0, top: 0 };
      if (tracks.actors[actor].kind !== "sensor" && tracks.pose(actor, this.time, sample, pose)) {
        [pose.left, pose.top] = this.camera.toScreen(pose.x, pose.y);
        found.push(pose);
      }
    }
    return found;
  }

  /** Return whether a moving actor of the other recording is elsewhere in this one. @param {Recorded} ghost @param {Drawn} drawn */
  differs(ghost, { actor, x, y }) {
    if (!moves(ghost.tracks.actors[actor])) return false;
    const twin = ghost.twin(actor);
    const same = this.places.get(twin);
    return !same || Math.hypot(same.x - x, same.y - y) > APART + LATE * this.tracks.speed(twin, this.time);
  }

  drawTrails() {
    const { ghost } = this;
    const shown = new Set(this.ghosts.map(({ actor }) => ghost?.twin(actor)));
    for (const one of this.ghosts) if (ghost) this.drawTrail(ghost.tracks, one, theme.colors.other, LONG_TRAIL);
    for (const one of this.shown) {
      const { id, kind, color } = this.tracks.actors[one.actor];
      if (REST.has(kind) || kind === "traffic light") continue;
      const long = id === this.camera.followed || shown.has(one.actor);
      this.drawTrail(this.tracks, one, color, long ? LONG_TRAIL : TRAIL);
    }
    this.context.globalAlpha = 1;
  }

  /** @param {import("./tracks").Tracks} tracks @param {Drawn} drawn @param {string} color @param {number} length */
  drawTrail(tracks, { actor, x, y, left, top }, color, length) {
    const { context, camera, time } = this;
    const reach = length * FAST * camera.scale;
    if (Math.max(-left, -top, left - camera.width, top - camera.height) > reach) return;
    const run = tracks.path(actor, time - length, time).pop();
    if (!run) return;
    run.push(x, y);
    const long = length > TRAIL;
    context.lineCap = "butt";
    context.strokeStyle = color;
    context.lineWidth = Math.max(tracks.actors[actor].kind === "walker" ? 0.3 : 0.6, (long ? 2.5 : 1.5) / camera.scale);
    const points = run.length / 2;
    const stride = Math.max(1, Math.ceil(points / FADES));
    for (let from = 0; from < points - 1; from += stride) {
      const to = Math.min(points - 1, from + stride);
      context.beginPath();
      for (let i = from; i <= to; i++) context.lineTo(run[2 * i] - this.origin.x, run[2 * i + 1] - this.origin.y);
      context.globalAlpha = (long ? 0.75 : 0.4) * (to / points) ** 1.5;
      context.stroke();
    }
  }

  /** Draw the paths of actors from one time to another: solid up to a time, dotted from then on.
   * @param {number[]} actors @param {number} start @param {number} time @param {number} stop */
  drawPaths(actors, start, time, stop) {
    const { context, camera } = this;
    camera.apply(context, this.ratio, this.origin);
    context.lineCap = "round";
    for (const actor of actors) {
      context.strokeStyle = this.tracks.actors[actor].color;
      context.lineWidth = 3 / camera.scale;
      for (const [from, to, dotted, alpha] of /** @type {const} */ ([[time, stop, true, 0.6], [start, time, false, 0.9]])) {
        context.setLineDash(dotted ? [0.1, 1.2] : []);
        context.globalAlpha = alpha;
        for (const run of this.tracks.path(actor, from, to)) {
          context.beginPath();
          for (let i = 0; i < run.length; i += 2) context.lineTo(run[i] - this.origin.x, run[i + 1] - this.origin.y);
          context.stroke();
        }
      }
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
  }

  /** Draw a cross where something collided. */
  drawCollisions() {
    for (const recording of this.ghost ? [this.ghost, this.recording] : [this.recording]) {
      for (const [x, y] of recording.tracks.marksAt(this.time)) this.drawCross(...this.camera.toScreen(x, y), 0.75);
    }
  }

  /** @param {number} left @param {number} top @param {number} alpha */
  drawCross(left, top, alpha) {
    const { context, camera } = this;
    const arm = Math.max(4, 0.9 * camera.scale);
    context.globalAlpha = alpha;
    context.strokeStyle = theme.tones.collision;
    context.lineWidth = Math.max(2, 0.3 * camera.scale);
    context.lineCap = "round";
    context.beginPath();
    context.moveTo(left - arm, top - arm);
    context.lineTo(left + arm, top + arm);
    context.moveTo(left + arm, top - arm);
    context.lineTo(left - arm, top + arm);
    context.stroke();
    context.globalAlpha = 1;
  }

  /** Mark the incidents around the present time. */
  drawIncidents() {
    const { context, camera, time } = this;
    for (const recording of this.ghost ? [this.ghost, this.recording] : [this.recording]) {
      for (const { incident, start } of recording.incidentsIn(time - NOTED, time + NOTED)) {
        const { kind, place } = incident;
        const late = time - start;
        if (late >= NOTED || (late < 0 && kind !== "collision") || !place) continue;
        const [left, top] = camera.toScreen(...place);
        context.globalAlpha = 1 - Math.abs(late) / NOTED;
        context.lineWidth = 2;
        context.strokeStyle = theme.tones[kind];
        context.fillStyle = theme.tones[kind] + "24";
        this.circle(left, top, Math.max(14, 3.4 * camera.scale) * (late < 0 ? 1 + 0.6 * -late : 1));
        context.fill();
        context.stroke();
      }
    }
    context.globalAlpha = 1;
  }

  /** @param {Drawn} drawn */
  drawActor({ actor, left, top, yaw }) {
    const { context, camera } = this;
    const { id, kind, color, paint, hero, shape } = this.tracks.actors[actor];
    const [, , length, width] = this.extent(this.recording, actor);
    const heading = this.tracks.lying(actor, this.time) ?? yaw;
    const size = camera.scale * Math.max(length, width);
    if (Math.max(-left, -top, left - camera.width, top - camera.height) > size + 30) return;
    if (kind === "traffic light") {
      this.drawLamp(actor, left, top);
      return;
    }
    const marked = id === camera.followed || actor === this.hovered;
    const isMoving = moves(this.tracks.actors[actor]);
    context.save();
    context.translate(left, top);
    if (marked || hero) this.drawGlow(color, Math.max(size, SMALLEST) + 12);
    const [path, halfLength, halfWidth] = this.outline(this.recording, { actor, heading }, REST.has(kind) ? 2 : SMALLEST, shape === "walker" ? 3 : 0);
    context.globalAlpha = REST.has(kind) ? 0.5 : 1;
    context.shadowColor = isMoving ? theme.colors.shade : "transparent";
    [context.shadowBlur, context.shadowOffsetY] = [0.5 * halfWidth * this.ratio, 0.12 * halfWidth * this.ratio];
    context.fillStyle = visible(paint ?? color);
    context.fill(path);
    context.shadowColor = "transparent";
    const isDetailed = halfLength > DETAILED || (shape === "walker" && halfLength > 4);
    if (isMoving && isDetailed) details(context, shape, halfLength, halfWidth, this.tracks.lampsOf(actor, this.time));
    context.lineWidth = marked ? 2 : 1;
    context.strokeStyle = marked ? theme.colors.text : hero ? color : theme.colors.edge;
    if (marked || hero || kind === "vehicle") context.stroke(path);
    context.restore();
  }

  /** Set the axes to those of an actor at the present point, and return its outline, half its length and half its width in px.
   * @param {Recorded} recording @param {{ actor: number, heading: number }} drawn @param {number} size the least size in px
   * @param {number} half the least half of a length or width in px @returns {[Path2D, number, number]} */
  outline(recording, { actor, heading }, size, half) {
    const { context, camera } = this;
    const [middle, side, length, width] = this.extent(recording, actor);
    const scale = camera.scale * Math.max(1, size / 2 / (camera.scale * Math.max(length, width)));
    const path = new Path2D();
    const halves = /** @type {[number, number]} */ ([Math.max(half, length * scale), Math.max(half, width * scale)]);
    context.rotate(camera.up - UP - heading);
    context.translate(middle * scale, -side * scale);
    outline(path, recording.tracks.actors[actor].shape, ...halves);
    return [path, ...halves];
  }

  /** Return x, y and half extents of an actor, those of a walker that lies along its body. @param {Recorded} recording @param {number} actor */
  extent({ tracks }, actor) {
    const { kind, box } = tracks.actors[actor];
    if (tracks.lying(actor, this.time) !== null) return [0, 0, Math.max(BODY, box[2]), Math.max(0.28, box[3])];
    return kind === "walker" ? [box[0], box[1], Math.min(0.22, box[2]), Math.max(0.28, box[3])] : box;
  }

  /** @param {string} color @param {number} radius */
  drawGlow(color, radius) {
    const { context } = this;
    const shade = context.createRadialGradient(0, 0, radius * 0.4, 0, 0, radius);
    shade.addColorStop(0, color + (theme.name === "dark" ? "66" : "99"));
    shade.addColorStop(1, color + "00");
    context.fillStyle = shade;
    this.circle(0, 0, radius);
    context.fill();
  }

  /** Begin a path that is a circle. @param {number} left @param {number} top @param {number} radius */
  circle(left, top, radius) {
    this.context.beginPath();
    this.context.arc(left, top, radius, 0, 7);
  }

  /** @param {number} actor @param {number} left @param {number} top */
  drawLamp(actor, left, top) {
    const { context, camera } = this;
    const state = this.tracks.lightState(actor, this.time);
    const color = this.recording.report.lights[state ?? -1]?.[1] ?? "#828287";
    const radius = Math.max(2.5, Math.min(7, 0.7 * camera.scale));
    context.globalAlpha = 0.22;
    context.fillStyle = color;
    this.circle(left, top, 2.2 * radius);
    if (camera.scale > 1 && state !== null && state < 3) context.fill();
    context.globalAlpha = 1;
    this.circle(left, top, radius);
    context.fill();
  }

  /** Draw an actor of the other recording: its outline, dashed. @param {Recorded} ghost @param {Drawn} drawn */
  drawGhost(ghost, { actor, left, top, yaw }) {
    const { context } = this;
    context.save();
    context.translate(left, top);
    const [path] = this.outline(ghost, { actor, heading: ghost.tracks.lying(actor, this.time) ?? yaw }, SMALLEST, 3);
    context.fillStyle = theme.colors.other + "40";
    context.strokeStyle = theme.colors.other;
    context.lineWidth = 2;
    context.setLineDash([4, 3]);
    context.fill(path);
    context.stroke(path);
    context.restore();
  }

  /** Draw a line from the followed actor to itself in the other recording. */
  drawDistance() {
    const { context, camera } = this;
    const own = this.places.get(this.tracks.indexOf(camera.followed, this.time));
    const ghost = own && this.ghosts.find(({ actor }) => this.ghost?.twin(actor) === own.actor);
    if (!own || !ghost) return;
    context.strokeStyle = theme.colors.other;
    context.lineWidth = 1.5;
    context.setLineDash([2, 4]);
    context.beginPath();
    context.moveTo(own.left, own.top);
    context.lineTo(ghost.left, ghost.top);
    context.stroke();
    context.setLineDash([]);
  }

  /** Draw names, the most important first; those that would overlap others are left out. */
  drawLabels() {
    const { camera, tracks } = this;
    const taken = /** @type {number[][]} */ ([]);
    /** @param {Drawn} drawn */
    const importance = ({ actor }) => {
      const { id, kind, hero } = tracks.actors[actor];
      if (actor === this.hovered) return 5;
      if (id === camera.followed) return 4;
      return hero ? 3 : kind === "vehicle" ? 2 : kind === "walker" ? 1 : 0;
    };
    const named = this.shown.map((one) => ({ ...one, importance: importance(one) }));
    named.sort((a, b) => b.importance - a.importance);
    for (const { actor, left, top, importance: rank } of named) {
      if (rank < (camera.scale > 3.5 ? 1 : 3)) break;
      if (left < 0 || top < 0 || left > camera.width || top > camera.height) continue;
      this.label(actor, left, top, taken, rank > 3);
    }
    this.context.globalAlpha = 1;
  }

  /** Draw the name of an actor above or below it, all of it on the map, if there is room; with its speed under the pointer.
   * @param {number} actor @param {number} left @param {number} top @param {number[][]} taken @param {boolean} always */
  label(actor, left, top, taken, always) {
    const { context, camera } = this;
    const { label, box } = this.tracks.actors[actor];
    context.font = `600 12px ${FONT}`;
    const speed = actor === this.hovered ? this.tracks.speed(actor, this.time) * 3.6 : NaN;
    const text = (label.length > 26 ? `${label.slice(0, 25)}…` : label) + (Number.isNaN(speed) ? "" : ` · ${speed.toFixed(0)} km/h`);
    const half = context.measureText(text).width / 2 + 4;
    const middle = Math.max(half, Math.min(camera.width - half, left));
    const reach = Math.max(9, Math.max(box[2], box[3]) * camera.scale);
    /** @param {number} line */
    const clashes = (line) => taken.some(([x, y, width]) => Math.abs(x - middle) < width + half && Math.abs(y - line) < 15);
    const lines = [top - reach - 8, top + reach + 17].filter((line) => line >= 14 && line <= camera.height - 6);
    const bottom = lines.find((line) => !clashes(line)) ?? (always ? lines[0] : undefined);
    if (bottom === undefined) return;
    taken.push([middle, bottom, half]);
    context.globalAlpha = always ? 1 : 0.8;
    this.text(text, middle, bottom, theme.colors.text);
  }

  /** Draw a text with a halo. @param {string} text @param {number} left @param {number} bottom @param {string} color */
  text(text, left, bottom, color) {
    const { context } = this;
    context.font = `600 12px ${FONT}`;
    context.textAlign = "center";
    context.lineJoin = "round";
    context.lineWidth = 4;
    context.strokeStyle = theme.colors.halo;
    context.fillStyle = color;
    context.strokeText(text, left, bottom);
    context.fillText(text, left, bottom);
  }

  /** Mark the actor under the pointer, and return whether it is another one. @param {number | null} left @param {number} top */
  hover(left, top) {
    const before = this.hovered;
    this.hovered = left === null ? -1 : this.actorAt(left, top);
    this.canvas.classList.toggle("over", this.hovered >= 0);
    return this.hovered !== before;
  }

  /** Return the actor at a point of the screen, or -1. @param {number} left @param {number} top */
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
}
