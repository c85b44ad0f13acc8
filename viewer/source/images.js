// What the cameras of the recordings saw, beside the view from above, in step with the time.

import { bytesOf, countUntil } from "./data.js";
import { byId, element, letterMark, press } from "./elements.js";

export class CameraImages {
  /** images: of each recording, those of a camera, or null. changed: is called when they are shown or hidden.
   * @param {(Images | null)[]} images @param {Recorded[]} recordings @param {() => void} changed */
  constructor(images, recordings, changed) {
    this.frame = byId("cameras");
    this.button = byId("images");
    this.changed = changed;
    const letters = recordings.map(({ letter }) => (recordings.length > 1 ? letter : ""));
    this.views = images.flatMap((some, index) => (some ? [new CameraView(some, letters[index])] : []));
    this.frame.append(...this.views.map(({ figure }) => figure));
    this.frame.hidden = this.button.hidden = !this.views.length;
    document.body.classList.toggle("with-images", !this.frame.hidden);
  }

  toggle() {
    this.frame.hidden = !this.frame.hidden;
    press("images", !this.frame.hidden);
    document.body.classList.toggle("with-images", !this.frame.hidden);
    this.changed();
  }

  /** @param {number} time */
  show(time) {
    if (!this.frame.hidden) for (const view of this.views) view.show(time);
  }
}

class CameraView {
  /** @param {Images} images @param {string} letter */
  constructor({ camera, size, longest, times, images }, letter) {
    this.longest = longest;
    this.times = times;
    this.images = images;
    this.canvas = element("canvas", "image");
    [this.canvas.width, this.canvas.height] = size;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `The image of the camera ${camera}`);
    this.context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d", { alpha: false }));
    this.absence = element("span", "absence", "No image at this time");
    const name = element("span", "", camera);
    const caption = element("figcaption", "", "", [...(letter ? [letterMark(letter)] : []), name, this.absence]);
    this.figure = element("figure", "camera", "", [this.canvas, caption]);
    this.wanted = -2; // the index of the image to show; -1 if there is none
    this.drawn = -1; // that of the image in the canvas
    this.busy = false;
  }

  /** Show the latest image at a time, if it is not too old. @param {number} time */
  show(time) {
    const latest = countUntil(this.times, time + 1e-3) - 1;
    const index = latest >= 0 && time - this.times[latest] <= this.longest ? latest : -1;
    if (index === this.wanted) return;
    this.wanted = index;
    this.absence.hidden = index >= 0;
    this.figure.classList.toggle("blank", index < 0);
    if (!this.busy) this.draw();
  }

  /** Decode and draw images until the wanted one is drawn; those that were wanted in between are left out. */
  async draw() {
    this.busy = true;
    while (this.wanted >= 0 && this.drawn !== this.wanted) {
      const index = this.wanted;
      const image = await createImageBitmap(new Blob([bytesOf(this.images[index])], { type: "image/webp" }));
      this.context.drawImage(image, 0, 0, this.canvas.width, this.canvas.height);
      image.close();
      this.drawn = index;
    }
    this.busy = false;
  }
}
