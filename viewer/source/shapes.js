// The outlines of actors from above, in px: the front is to the right, the middle at 0, 0.

import { theme } from "./theme.js";

export const DETAILED = 9; // px, half the length from which windows are drawn
export const BODY = 0.9; // m, half the length of a walker that was hit

/** The bits of lamps in CARLA's VehicleLightState. */
const LAMPS = { head: 2 | 4 | 128, brake: 8, right: 16, left: 32, reverse: 64 };

/** Add the outline of an actor to a path. @param {CanvasPath} path @param {string} shape @param {number} length @param {number} width */
export function outline(path, shape, length, width) {
  if (shape === "walker") {
    path.ellipse(0, 0, length, width, 0, 0, 7);
  } else if (shape === "cycle") {
    path.roundRect(-length, -width * 0.5, 2 * length, width, width * 0.5);
  } else if (shape === "car") {
    const [nose, tail] = [width * 0.62, width * 0.42];
    path.moveTo(-length + tail, -width);
    path.lineTo(length - nose, -width);
    path.bezierCurveTo(length - nose * 0.3, -width, length, -width * 0.75, length, -width * 0.3);
    path.lineTo(length, width * 0.3);
    path.bezierCurveTo(length, width * 0.75, length - nose * 0.3, width, length - nose, width);
    path.lineTo(-length + tail, width);
    path.quadraticCurveTo(-length, width, -length, width - tail);
    path.lineTo(-length, -width + tail);
    path.quadraticCurveTo(-length, -width, -length + tail, -width);
    path.closePath();
  } else {
    path.roundRect(-length, -width, 2 * length, 2 * width, Math.min(length, width) * (shape === "truck" ? 0.18 : 0.3));
  }
}

/** Draw the windows, lamps and riders on an outline; lamps are the bits of those that are lit.
 * @param {CanvasRenderingContext2D} context @param {string} shape @param {number} length @param {number} width
 * @param {number} lamps */
export function details(context, shape, length, width, lamps) {
  const { colors } = theme;
  if (shape === "cycle" || shape === "walker") {
    context.fillStyle = colors.window;
    context.beginPath();
    if (shape === "cycle") context.ellipse(-length * 0.1, 0, width * 0.5, width * 0.95, 0, 0, 7);
    else context.arc(0, 0, Math.min(length, width) * 0.55, 0, 7);
    context.fill();
    return;
  }
  /** @param {number} front @param {number} back @param {number} frontWidth @param {number} backWidth */
  const glass = (front, back, frontWidth, backWidth) => {
    context.moveTo(front * length, -frontWidth * width);
    context.lineTo(back * length, -backWidth * width);
    context.lineTo(back * length, backWidth * width);
    context.lineTo(front * length, frontWidth * width);
    context.closePath();
  };
  context.fillStyle = colors.window;
  context.beginPath();
  if (shape === "truck") {
    glass(0.93, 0.84, 0.86, 0.86);
    context.fill();
    context.fillStyle = "rgba(255, 255, 255, 0.16)";
    context.fillRect(-0.96 * length, -0.88 * width, 1.68 * length, 1.76 * width);
    context.fillStyle = colors.window;
    context.fillRect(0.72 * length, -width, Math.max(1, 0.02 * length), 2 * width);
  } else {
    glass(0.47, 0.2, 0.82, 0.68);
    glass(-0.52, -0.74, 0.66, 0.76);
    context.rect(-0.48 * length, -0.86 * width, 0.66 * length, 0.12 * width);
    context.rect(-0.48 * length, 0.74 * width, 0.66 * length, 0.12 * width);
    context.fill();
  }
  const lamp = Math.max(1, 0.16 * width);
  /** @param {number} left @param {number} top @param {string} color @param {boolean} lit */
  const glow = (left, top, color, lit) => {
    context.shadowColor = color;
    context.shadowBlur = lit ? 5 * lamp : 0;
    context.fillStyle = color;
    context.globalAlpha = lit ? 1 : 0.6;
    context.fillRect(left, top, lamp * (lit ? 1 : 0.6), 2 * lamp);
    context.shadowBlur = 0;
  };
  for (const [side, turning] of [[-1, LAMPS.left], [1, LAMPS.right]]) {
    const top = side * 0.68 * width - lamp;
    glow(0.955 * length - lamp * 0.5, top, "#fff6d5", Boolean(lamps & LAMPS.head));
    glow(-0.99 * length, top, "#ff4d4d", Boolean(lamps & LAMPS.brake));
    if (lamps & LAMPS.reverse) glow(-0.99 * length, side * 0.4 * width - lamp, "#ffffff", true);
    if (!(lamps & turning)) continue;
    for (const end of [0.9, -0.96]) glow(end * length, side * 0.92 * width - lamp, "#ffa726", true);
  }
  context.globalAlpha = 1;
}

/** Return a colour that is made lighter or darker, so that it differs from the road and from windows. @param {string} color */
export function visible(color) {
  const parts = [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16));
  const light = 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
  const [least, most] = theme.name === "dark" ? [105, 240] : [80, 240];
  const [part, goal] = light < least ? [(least - light) / 255, 255] : [Math.max(0, light - most) / 255, 0];
  return `rgb(${parts.map((value) => Math.round(value + part * (goal - value))).join(", ")})`;
}
