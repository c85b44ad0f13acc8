// The visible part of the world, and the actor that the view follows.

const CLOSEST = 60; // px/m
const FARTHEST = 0.02;
const CALM = 0.5; // s, in which two thirds of a rotation are done
export const UP = Math.PI / 2;

export class Camera {
  constructor() {
    this.x = 0; // m, of the centre
    this.y = 0;
    this.scale = 6; // px/m
    this.up = UP; // the direction that points up on the screen, in radians
    this.width = 1; // px
    this.height = 1;
    this.turns = false; // whether it rotates with the followed actor
    this.followed = /** @type {number | null} */ (null); // an id
  }

  /** Follow the followed actor; pose is null if it is absent. @param {Pose | null} pose @param {number} seconds @param {boolean} jumped */
  step(pose, seconds, jumped) {
    if (pose) {
      this.x = pose.x;
      this.y = pose.y;
    }
    const goal = this.turns && pose ? pose.yaw : this.turns && this.followed !== null ? this.up : UP;
    const turn = Math.atan2(Math.sin(goal - this.up), Math.cos(goal - this.up));
    this.up += jumped ? turn : turn * -Math.expm1(-seconds / CALM);
    return Math.abs(turn) > 1e-3;
  }

  /** Set a context's axes to those of the world, relative to an origin.
   * @param {CanvasRenderingContext2D} context @param {number} ratio @param {{ x: number, y: number }} origin */
  apply(context, ratio, origin) {
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.translate(this.width / 2, this.height / 2);
    context.rotate(this.up - UP);
    context.scale(this.scale, -this.scale);
    context.translate(origin.x - this.x, origin.y - this.y);
  }

  /** @param {number} x @param {number} y @returns {[number, number]} */
  toScreen(x, y) {
    const [right, ahead] = [(x - this.x) * this.scale, (y - this.y) * this.scale];
    const [sine, cosine] = [Math.sin(this.up - UP), Math.cos(this.up - UP)];
    return [this.width / 2 + cosine * right + sine * ahead, this.height / 2 + sine * right - cosine * ahead];
  }

  /** @param {number} left @param {number} top */
  toWorld(left, top) {
    const [right, down] = [left - this.width / 2, top - this.height / 2];
    const [sine, cosine] = [Math.sin(this.up - UP), Math.cos(this.up - UP)];
    return [this.x + (cosine * right + sine * down) / this.scale, this.y + (sine * right - cosine * down) / this.scale];
  }

  /** Return half of the visible diagonal, in m. */
  get reach() {
    return Math.hypot(this.width, this.height) / 2 / this.scale;
  }

  /** Zoom with a fixed point on the screen. @param {number} factor */
  zoom(factor, left = this.width / 2, top = this.height / 2) {
    const [x, y] = this.toWorld(left, top);
    this.scale = Math.min(CLOSEST, Math.max(FARTHEST, this.scale * factor));
    if (this.followed !== null) return;
    const [newX, newY] = this.toWorld(left, top);
    this.x += x - newX;
    this.y += y - newY;
  }

  /** Move the view by px, and stop following. @param {number} right @param {number} down */
  pan(right, down) {
    this.followed = null;
    [this.x, this.y] = this.toWorld(this.width / 2 - right, this.height / 2 - down);
  }

  /** Show a rectangle, in m. @param {number[]} rectangle */
  fit([left, low, right, high]) {
    this.followed = null;
    this.x = (left + right) / 2;
    this.y = (low + high) / 2;
    const across = Math.min(this.width / (right - left + 20), this.height / (high - low + 20));
    this.scale = Math.min(CLOSEST / 4, Math.max(FARTHEST, across));
  }

  /** Show at least a width in m, and at most twice that width. @param {number} metres */
  show(metres) {
    const shortest = Math.min(this.width, this.height * 1.6);
    this.scale = Math.min(shortest / metres, Math.max(this.scale, shortest / metres / 2));
  }
}
