// The scene in Rerun's viewer, instead of the view from above.

import { byId, press } from "./elements.js";

export class Space {
  /** changed: is called when it is opened or closed. @param {Report} report @param {() => void} changed */
  constructor(report, changed) {
    this.frame = /** @type {HTMLIFrameElement} */ (byId("space"));
    this.button = /** @type {HTMLButtonElement} */ (byId("solid"));
    this.sign = byId("loading");
    this.button.hidden = !report.viewer;
    document.body.classList.toggle("with-viewer", report.viewer);
    this.changed = changed;
    this.shown = "";
    if (location.protocol === "file:") {
      this.button.disabled = true;
      this.button.title = "The view in 3D needs a server: carla-recap report --serve";
    } else {
      this.button.title = "View in 3D (V)";
    }
    // The viewer reports how much of it is loaded, and when it is ready: then the request is sent again.
    window.addEventListener("message", ({ data, source, origin }) => {
      if (source !== this.frame.contentWindow || origin !== location.origin) return;
      if (Number.isFinite(data.loaded)) /** @type {HTMLProgressElement} */ (this.sign.querySelector("progress")).value = data.loaded;
      if (!data.ready && !data.failed) return;
      this.sign.hidden = true;
      this.shown = "";
      this.changed();
    });
  }

  get isOpen() {
    return !this.frame.hidden;
  }

  toggle() {
    if (this.button.disabled) return;
    if (!this.frame.src) {
      this.frame.src = "rerun/index.html";
      this.sign.hidden = false;
    }
    this.frame.hidden = this.isOpen;
    press("solid", this.isOpen);
    document.body.classList.toggle("solid", this.isOpen);
    this.changed();
  }

  /** Show a time, from behind an actor of the tracks, or null. @param {number} time @param {Actor | null} actor */
  show(time, actor) {
    if (!this.isOpen) return;
    const moves = actor && (actor.kind === "vehicle" || actor.kind === "walker");
    const wanted = { time, camera: moves ? `cameras/follow_${actor.id}.rbl` : null };
    if (JSON.stringify(wanted) === this.shown) return;
    this.shown = JSON.stringify(wanted);
    this.frame.contentWindow?.postMessage(wanted, location.origin);
  }
}
