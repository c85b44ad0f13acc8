// Mouse, pen and touch on an element: drag, pinch, wheel, click.

const SLACK = 5; // px, the largest movement of a click

/** What is called, with px from the left and the top of the element: for a drag how far it went, too; for a pointer that has left,
 * `hover` gets null; `pan` is a wheel to the side. Without `click`, a press is a drag already.
 * @typedef {{ drag?: (right: number, down: number, left: number) => void, zoom?: (factor: number, left: number, top: number) => void,
 *   click?: (left: number, top: number) => void, hover?: (left: number | null, top: number) => void, pan?: (right: number) => void }} On */

export class Pointing {
  /** @param {HTMLElement} node @param {On} on */
  constructor(node, on) {
    this.node = node;
    this.on = on;
    this.down = /** @type {Map<number, [number, number]>} */ (new Map()); // pointers, by id
    this.moved = 0;
    node.addEventListener("pointerdown", (event) => this.press(event));
    node.addEventListener("pointermove", (event) => this.move(event));
    node.addEventListener("pointerup", (event) => this.release(event, true));
    node.addEventListener("pointercancel", (event) => this.release(event, false));
    node.addEventListener("pointerleave", () => on.hover?.(null, 0));
    node.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  /** @param {MouseEvent} event @returns {[number, number]} */
  place({ clientX, clientY }) {
    const { left, top } = this.node.getBoundingClientRect();
    return [clientX - left, clientY - top];
  }

  /** @param {PointerEvent} event */
  press(event) {
    if (event.button) return;
    if (this.on.drag) this.node.setPointerCapture(event.pointerId);
    this.down.set(event.pointerId, this.place(event));
    if (this.down.size === 1) this.moved = 0;
    if (!this.on.click) this.on.drag?.(0, 0, this.place(event)[0]);
  }

  /** @param {PointerEvent} event */
  move(event) {
    const now = this.place(event);
    const before = this.down.get(event.pointerId);
    if (event.pointerType === "mouse" && (!before || !this.on.click)) this.on.hover?.(...now);
    if (!before) return;
    const other = [...this.down].find(([id]) => id !== event.pointerId)?.[1];
    this.moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
    this.down.set(event.pointerId, now);
    if (this.on.click && this.moved < SLACK) return;
    if (other) {
      /** @param {number[]} point */
      const spread = (point) => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
      this.on.zoom?.(spread(now) / spread(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else {
      this.on.drag?.(now[0] - before[0], now[1] - before[1], now[0]);
    }
  }

  /** @param {PointerEvent} event @param {boolean} done */
  release(event, done) {
    this.down.delete(event.pointerId);
    if (done && !this.down.size && this.moved < SLACK) this.on.click?.(...this.place(event));
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    event.preventDefault();
    const unit = event.deltaMode ? 30 : 1;
    const sideways = event.deltaX || (event.shiftKey ? event.deltaY : 0);
    if (this.on.pan && Math.abs(sideways) >= Math.abs(event.deltaY)) this.on.pan(sideways * unit);
    else this.on.zoom?.(Math.exp(-event.deltaY * unit * (event.ctrlKey ? 0.01 : 0.0015)), ...this.place(event));
  }
}
