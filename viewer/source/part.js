// The part of the time that the timeline and the plots show: all of it, or what was zoomed in on.

import { Pointing } from "./pointing.js";

const SHORTEST = 0.5; // s
const MARGIN = 0.08; // of the part, which is ahead of the present time at least

export class Part extends EventTarget {
  /** @param {number} length the length of the recording in s */
  constructor(length) {
    super();
    this.length = Math.max(length, 0.1);
    this.start = 0;
    this.stop = this.length;
    this.shown = -1; // the time that it followed last
  }

  get isWhole() {
    return this.stop - this.start >= this.length;
  }

  /** Return where in the part a time is, from 0 to 1; outside of it, less or more. @param {number} time */
  share(time) {
    return (time - this.start) / (this.stop - this.start);
  }

  /** Return the time at a share, within the part. @param {number} share */
  timeAt(share) {
    return this.start + Math.min(1, Math.max(0, share)) * (this.stop - this.start);
  }

  /** Zoom in, or with a factor below 1 out, so that a time stays where it is. @param {number} factor @param {number} time */
  zoom(factor, time) {
    const shorter = Math.max(Math.min(SHORTEST, this.length), (this.stop - this.start) / factor);
    this.set(time - this.share(time) * shorter, shorter);
  }

  /** Move by a share of the part. @param {number} share */
  move(share) {
    this.set(this.start + share * (this.stop - this.start), this.stop - this.start);
  }

  /** Move on or back to another time, if that is outside the part; while it plays, by most of it, so that it moves seldom.
   * @param {number} time @param {boolean} playing */
  show(time, playing) {
    if (time === this.shown) return;
    this.shown = time;
    const share = this.share(time);
    const edge = playing && this.stop < this.length ? 1 - MARGIN : 1;
    if (this.isWhole || (share >= 0 && share <= edge)) return;
    if (share > 1 || share < 0) this.centre(time);
    else this.move(edge - MARGIN);
  }

  /** @param {number} time */
  centre(time) {
    this.move(this.share(time) - 0.5);
  }

  /** @param {number} start @param {number} long */
  set(start, long) {
    const [before, length] = [this.start, this.stop - this.start];
    const short = Math.min(long, this.length);
    this.start = Math.min(Math.max(0, start), this.length - short);
    this.stop = this.start + short;
    if (this.start !== before || short !== length) this.dispatchEvent(new Event("change"));
  }
}

/** Let the wheel and two fingers on an element zoom a part, and a double click show all of it.
 * @param {HTMLElement} node @param {Part} part @param {() => number} width returns the px that the part takes from the left on
 * @param {import("./pointing").On} more */
export function zoomable(node, part, width, more = {}) {
  /** @param {number} left */
  const timeAt = (left) => part.timeAt(left / width());
  const pan = (/** @type {number} */ right) => part.move(right / width());
  new Pointing(node, { zoom: (factor, left) => part.zoom(factor, timeAt(left)), pan, ...more });
  node.addEventListener("dblclick", ({ target }) => /** @type {Element} */ (target).closest("button") || part.set(0, part.length));
}
