// What the cameras of the recordings saw, beside the view from above, in step with the time.
"use strict";

class CameraImages {
  /** images: of each recording, those of a camera, or null. changed: is called when they are shown or hidden. */
  constructor(images, recordings, changed) {
    this.frame = document.getElementById("cameras");
    this.button = document.getElementById("images");
    this.changed = changed;
    this.views = [];
    images.forEach((some, index) => {
      if (some) this.views.push(new CameraView(some, recordings.length > 1 ? recordings[index].letter : ""));
    });
    this.frame.append(...this.views.map(({ figure }) => figure));
    this.frame.hidden = this.button.hidden = !this.views.length;
    document.getElementById("images-key").hidden = this.button.hidden;
    document.body.classList.toggle("with-images", !this.frame.hidden);
    this.button.addEventListener("click", () => this.toggle());
  }

  toggle() {
    if (this.button.hidden) return;
    this.frame.hidden = !this.frame.hidden;
    this.button.setAttribute("aria-pressed", String(!this.frame.hidden));
    document.body.classList.toggle("with-images", !this.frame.hidden);
    this.changed();
  }

  show(time) {
    if (!this.frame.hidden) for (const view of this.views) view.show(time);
  }
}

class CameraView {
  constructor({ camera, size, longest, times, images }, letter) {
    [this.longest, this.times, this.images] = [longest, times, images];
    this.canvas = element("canvas", "image");
    [this.canvas.width, this.canvas.height] = size;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `The image of the camera ${camera}`);
    this.context = this.canvas.getContext("2d", { alpha: false });
    this.absence = element("span", "absence", "No image at this time");
    const name = element("span", "", camera);
    const caption = element("figcaption", "", "", [...(letter ? [element("i", `letter of-${letter}`, letter)] : []), name, this.absence]);
    this.figure = element("figure", "camera", "", [this.canvas, caption]);
    this.wanted = -2; // the index of the image to show; -1 if there is none
    this.drawn = -1; // that of the image in the canvas
    this.busy = false;
  }

  /** Show the latest image at a time, if it is not too old. */
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
