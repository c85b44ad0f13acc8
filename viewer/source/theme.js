// The colours of the canvas, and the switch between light and dark.

/** The colours of the style sheet that are drawn with. */
const NAMES = [
  "map", "grid", "median", "sidewalk", "shoulder", "bike", "road", "crossing", "white", "yellow", "text", "quiet", "halo", "edge", "shade",
  "window", "accent", "other", "line",
];
const KEPT = "carla-recap-theme";

export class Theme extends EventTarget {
  constructor() {
    super();
    this.name = /** @type {"dark" | "light" | null} */ (null);
    this.fallback = /** @type {"dark" | "light" | null} */ (null);
    this.system = window.matchMedia("(prefers-color-scheme: light)");
    this.system.addEventListener("change", () => this.apply());
    const print = window.matchMedia("print");
    this.printing = print.matches;
    print.addEventListener("change", () => {
      this.printing = print.matches;
      this.apply();
    });
    this.colors = /** @type {Record<string, string>} */ ({});
    this.tones = /** @type {Record<string, string>} */ ({});
    this.apply();
  }

  /** The theme that was chosen with the switch, or null. */
  get chosen() {
    try {
      const kept = localStorage.getItem(KEPT);
      return kept === "dark" || kept === "light" ? kept : null;
    } catch {
      return this.fallback; // the browser keeps nothing for files
    }
  }

  /** @param {"dark" | "light"} name */
  choose(name) {
    this.fallback = name;
    try {
      localStorage.setItem(KEPT, name);
    } catch {
      // It lasts as long as the page.
    }
    this.apply();
  }

  toggle() {
    this.choose(this.name === "dark" ? "light" : "dark");
  }

  apply() {
    const name = this.printing ? "light" : (this.chosen ?? (this.system.matches ? "light" : "dark"));
    if (name === this.name) return;
    this.name = name;
    this.tones = Object.fromEntries(Object.entries(KINDS).map(([kind, colors]) => [kind, colors[name]]));
    document.documentElement.dataset.theme = name;
    const style = getComputedStyle(document.documentElement);
    this.colors = Object.fromEntries(NAMES.map((each) => [each, style.getPropertyValue(`--${each}`).trim()]));
    document.querySelector('meta[name="theme-color"]')?.setAttribute("content", this.colors.map);
    this.dispatchEvent(new Event("change"));
  }
}

/** Return the style sheet by which elements of a kind of incident have its colour. */
function tones() {
  const sheet = new CSSStyleSheet();
  const rules = Object.entries(KINDS).map(([kind, { dark, light }]) => {
    const elements = `[data-kind="${kind}"]`;
    return `${elements} { --tone: ${dark}; } [data-theme="light"] ${elements} { --tone: ${light}; }`;
  });
  sheet.replaceSync(rules.join("\n"));
  return sheet;
}

export const theme = new Theme();
document.adoptedStyleSheets = [tones()];
