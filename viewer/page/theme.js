// The colours of the canvas, and the switch between light and dark.
"use strict";

const PALETTES = {
  dark: {
    ground: "#14171d", grid: "#1c2027", road: "#2b303b", crossing: "#596173", line: "#6b7385", stop: "#c6ccd8",
    text: "#eef0f5", quiet: "#98a1b3", halo: "#14171d", edge: "rgba(238, 240, 245, 0.5)", shade: "rgba(0, 0, 0, 0.45)",
    glass: "rgba(13, 16, 22, 0.78)", accent: "#ffb020", other: "#3cc8e8", frame: "#2c313d",
  },
  light: {
    ground: "#e9ece6", grid: "#dfe3db", road: "#bfc5cf", crossing: "#eef0f3", line: "#f6f7f9", stop: "#ffffff",
    text: "#171a21", quiet: "#5a6271", halo: "#f7f8f5", edge: "rgba(23, 26, 33, 0.6)", shade: "rgba(30, 36, 48, 0.28)",
    glass: "rgba(24, 28, 36, 0.72)", accent: "#b86e00", other: "#007a99", frame: "#d3d8df",
  },
};
const TONES = {
  dark: { collision: "#ff5f5f", "hard braking": "#ffa24d", blocked: "#b9a0ff" },
  light: { collision: "#cf2230", "hard braking": "#b45a00", blocked: "#6a45c9" },
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
    this.tones = TONES[name];
    document.documentElement.dataset.theme = name;
    document.querySelector('meta[name="theme-color"]').content = this.colors.ground;
    this.dispatchEvent(new Event("change"));
  }
}

const theme = new Theme();
