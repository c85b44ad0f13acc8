// What leaves the page: a link to the moment, and a picture of the view.

import { FONT } from "./stage.js";
import { theme } from "./theme.js";

/** Put a text into the clipboard, and return whether that succeeded. @param {string} text */
export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const field = Object.assign(document.createElement("textarea"), { value: text, className: "unseen" });
    document.body.append(field); // a frame of a notebook may not use the clipboard otherwise
    field.select();
    const copied = document.execCommand("copy");
    field.remove();
    return copied;
  }
}

/** Save a picture of some stages as they are arranged on the screen, with a line below. @param {Stage[]} stages
 * @param {string} line @param {string} name the name of the file */
export async function savePicture(stages, line, name) {
  const boxes = stages.map(({ canvas }) => canvas.getBoundingClientRect());
  const [left, top] = [Math.min(...boxes.map((box) => box.left)), Math.min(...boxes.map((box) => box.top))];
  const [right, bottom] = [Math.max(...boxes.map((box) => box.right)), Math.max(...boxes.map((box) => box.bottom))];
  const [ratio, foot] = [stages[0].ratio, 34];
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [Math.round((right - left) * ratio), Math.round((bottom - top + foot) * ratio)];
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
  context.fillStyle = theme.colors.halo;
  context.fillRect(0, 0, canvas.width, canvas.height);
  stages.forEach((stage, i) => context.drawImage(stage.canvas, (boxes[i].left - left) * ratio, (boxes[i].top - top) * ratio));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = `13px ${FONT}`;
  context.fillStyle = theme.colors.text;
  context.fillText(line, 12, bottom - top + 22, right - left - 24);
  const blob = await new Promise((done) => canvas.toBlob(done));
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
