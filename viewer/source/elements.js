// Elements of the document.

/** Return the element with an id. @param {string} id */
export const byId = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** Set the text of an element, if it is another one. @param {HTMLElement} node @param {string} text */
export function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Return a number with some decimals. @param {number} value @param {number} digits */
export function decimal(value, digits) {
  return (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits).replace("-", "−");
}

/** Show whether a button is pressed. @param {string} id @param {boolean} pressed */
export const press = (id, pressed) => byId(id).setAttribute("aria-pressed", String(pressed));

/** Return the icon with a path. @param {string} path */
export function icon(path) {
  const space = "http://www.w3.org/2000/svg";
  const drawing = document.createElementNS(space, "svg");
  const line = document.createElementNS(space, "path");
  drawing.setAttribute("viewBox", "0 0 16 16");
  drawing.setAttribute("aria-hidden", "true");
  line.setAttribute("d", path);
  drawing.append(line);
  return drawing;
}

/** Return the mark of a colour. @param {string} color */
export function swatch(color) {
  const mark = element("i", "swatch");
  mark.style.background = color;
  return mark;
}

/** Return the mark of one of two recordings. @param {string} letter */
export const letterMark = (letter) => element("i", `letter of-${letter}`, letter);

/** Return an element with a class, a text and children.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} name @param {string} [className] @param {string} [text] @param {(Node | string)[]} [children] */
export function element(name, className = "", text = "", children = []) {
  const node = document.createElement(name);
  if (className) node.className = className;
  if (text) node.textContent = text;
  node.append(...children);
  return node;
}

/** Return a button. @param {string} className @param {(Node | string)[]} children @param {() => void} run is called by a click */
export function buttonOf(className, children, run) {
  const button = element("button", className, "", children);
  button.type = "button";
  button.addEventListener("click", run);
  return button;
}

/** Let arrows, Home and End move the focus among some buttons. @param {KeyboardEvent} event @param {HTMLElement[]} buttons */
export function moveFocus(event, buttons) {
  const at = buttons.findIndex((button) => button === document.activeElement);
  const goal = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: buttons.length - 1 }[event.key];
  if (goal === undefined || at < 0) return;
  event.preventDefault();
  event.stopPropagation();
  buttons[goal]?.focus();
}
