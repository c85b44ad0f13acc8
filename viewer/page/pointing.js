// Mouse, pen and touch on the stage: drag, pinch, wheel, click.
"use strict";

const SLACK = 5; // px, the largest movement of a click

class Pointing {
  /** on: the callbacks for a picked actor, and for a changed view. */
  constructor(stage, on) {
    this.stage = stage;
    this.on = on;
    this.down = new Map(); // pointers, by id
    this.moved = 0;
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.release(event, true));
    canvas.addEventListener("pointercancel", (event) => this.release(event, false));
    canvas.addEventListener("pointerleave", () => this.hover(-1));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  press(event) {
    if (event.button) return;
    this.stage.canvas.setPointerCapture(event.pointerId);
    this.down.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (this.down.size === 1) this.moved = 0;
  }

  move(event) {
    const now = [event.offsetX, event.offsetY];
    const before = this.down.get(event.pointerId);
    if (!before) {
      if (event.pointerType === "mouse") this.hover(this.stage.actorAt(...now));
      return;
    }
    const other = [...this.down].find(([id]) => id !== event.pointerId)?.[1];
    this.moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
    this.down.set(event.pointerId, now);
    if (this.moved < SLACK) return;
    const { camera } = this.stage;
    if (other) {
      const spread = (point) => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
      camera.zoom(spread(now) / spread(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else {
      camera.pan(now[0] - before[0], now[1] - before[1]);
    }
    this.on.view(this.stage);
  }

  release(event, done) {
    this.down.delete(event.pointerId);
    if (!done || this.down.size || this.moved >= SLACK) return;
    const actor = this.stage.actorAt(event.offsetX, event.offsetY);
    if (actor >= 0) this.on.pick(actor);
  }

  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode ? 30 : 1;
    this.stage.camera.zoom(Math.exp(-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0015)), event.offsetX, event.offsetY);
    this.on.view(this.stage);
  }

  hover(actor) {
    if (actor === this.stage.hovered) return;
    this.stage.hovered = actor;
    this.stage.canvas.classList.toggle("over", actor >= 0);
    this.on.view(this.stage);
  }
}
