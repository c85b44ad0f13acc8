// The colours of the canvas, and the switch between light and dark.
"use strict";

const PALETTES = {
  dark: {
    ground: "#121519", grid: "#1a1e25", road: "#323845",
    surfaces: {
      median: "#1f2a24", sidewalk: "#20252e", shoulder: "#292f3a", bike: "#4a3a3c", road: "#323845", crossing: "#687184",
      white: "#a9b1c1", yellow: "#b98f3a",
    },
    text: "#eef0f5", quiet: "#98a1b3", halo: "#14171d", edge: "rgba(238, 240, 245, 0.5)", shade: "rgba(0, 0, 0, 0.5)",
    glass: "rgba(13, 16, 22, 0.8)", accent: "#ffb020", other: "#3cc8e8", frame: "#2c313d",
  },
  light: {
    ground: "#e6eae0", grid: "#dbe1d4", road: "#b4bac5",
    surfaces: {
      median: "#d2dcc4", sidewalk: "#f3f2ee", shoulder: "#c4c9d2", bike: "#d6b6ae", road: "#b4bac5", crossing: "#eceef2",
      white: "#ffffff", yellow: "#e8b02e",
    },
    text: "#171a21", quiet: "#5a6271", halo: "#f7f8f5", edge: "rgba(23, 26, 33, 0.65)", shade: "rgba(30, 36, 48, 0.3)",
    glass: "rgba(20, 24, 32, 0.78)", accent: "#a86200", other: "#007a99", frame: "#d3d8df",
  },
};
const KEPT = "carla-recap-theme";

class Theme extends EventTarget {
  constructor() {
    super();
    this.system = window.matchMedia("(prefers-color-scheme: light)");
    this.system.addEventListener("change", () => this.apply());
    window.matchMedia("print").addEventListener("change", ({ matches }) => this.print(matches));
    window.addEventListener("beforeprint", () => this.print(true));
    window.addEventListener("afterprint", () => this.print(false));
    this.printing = window.matchMedia("print").matches;
    this.apply();
  }

  /** The theme that was chosen with the switch, or null. */
  get chosen() {
    try {
      const kept = localStorage.getItem(KEPT);
      return kept in PALETTES ? kept : null;
    } catch {
      return this.fallback ?? null; // the browser keeps nothing for files
    }
  }

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

  print(printing) {
    this.printing = printing;
    this.apply();
  }

  apply() {
    const name = this.printing ? "light" : this.chosen ?? (this.system.matches ? "light" : "dark");
    if (name === this.name) return;
    this.name = name;
    this.colors = PALETTES[name];
    this.tones = Object.fromEntries(Object.entries(KINDS).map(([kind, colors]) => [kind, colors[name]]));
    document.documentElement.dataset.theme = name;
    document.querySelector('meta[name="theme-color"]').content = this.colors.ground;
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

const theme = new Theme();
document.adoptedStyleSheets = [tones()];
