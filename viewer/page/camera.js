// What part of the world is seen, and whom the view follows.
"use strict";

const CLOSEST = 60; // px/m
const FARTHEST = 0.02;
const CALM = 0.5; // s; after so long, two thirds of a turn are done
const UP = Math.PI / 2;

class Camera {
  constructor() {
    this.x = 0; // m, of the middle
    this.y = 0;
    this.scale = 6; // px/m
    this.up = UP; // the direction that is upwards, in radians
    this.width = 1; // px
    this.height = 1;
    this.turns = false; // whether it turns with the followed actor
    this.followed = null; // an id
  }

  /** Move on after the followed actor; pose is null where there is none. */
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

  /** Put a context's axes into the world, relative to an origin. */
  apply(context, ratio, origin) {
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.translate(this.width / 2, this.height / 2);
    context.rotate(this.up - UP);
    context.scale(this.scale, -this.scale);
    context.translate(origin.x - this.x, origin.y - this.y);
  }

  toScreen(x, y) {
    const [right, ahead] = [(x - this.x) * this.scale, (y - this.y) * this.scale];
    const [sine, cosine] = [Math.sin(this.up - UP), Math.cos(this.up - UP)];
    return [this.width / 2 + cosine * right + sine * ahead, this.height / 2 + sine * right - cosine * ahead];
  }

  toWorld(left, top) {
    const [right, down] = [left - this.width / 2, top - this.height / 2];
    const [sine, cosine] = [Math.sin(this.up - UP), Math.cos(this.up - UP)];
    return [this.x + (cosine * right + sine * down) / this.scale, this.y + (sine * right - cosine * down) / this.scale];
  }

  /** Half of what is seen, in m, from the middle to a corner. */
  get reach() {
    return Math.hypot(this.width, this.height) / 2 / this.scale;
  }

  /** Zoom so that what lies under a point stays there. */
  zoom(factor, left = this.width / 2, top = this.height / 2) {
    const [x, y] = this.toWorld(left, top);
    this.scale = Math.min(CLOSEST, Math.max(FARTHEST, this.scale * factor));
    if (this.followed !== null) return;
    const [newX, newY] = this.toWorld(left, top);
    this.x += x - newX;
    this.y += y - newY;
  }

  /** Move the view by px; whoever is followed is let go. */
  pan(right, down) {
    this.followed = null;
    const [x, y] = this.toWorld(this.width / 2 - right, this.height / 2 - down);
    [this.x, this.y] = [x, y];
  }

  /** Show a rectangle, in m. */
  fit([left, low, right, high]) {
    this.followed = null;
    this.x = (left + right) / 2;
    this.y = (low + high) / 2;
    const across = Math.min(this.width / (right - left + 20), this.height / (high - low + 20));
    this.scale = Math.min(CLOSEST / 4, Math.max(FARTHEST, across));
  }

  /** Show at least so many m from side to side, and no more than twice as many. */
  show(metres) {
    const shortest = Math.min(this.width, this.height * 1.6);
    this.scale = Math.min(shortest / metres, Math.max(this.scale, shortest / metres / 2));
  }
}
