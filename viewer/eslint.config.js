import js from "@eslint/js";

const names = (text) => Object.fromEntries(text.split(" ").map((name) => [name, "readonly"]));
const DATA = "KINDS GROUND RECORDINGS REPORTS IMAGES wasm_bindgen";
const BROWSER =
  "window document location history navigator performance localStorage globalThis console fetch setTimeout clearTimeout atob " +
  "requestAnimationFrame getComputedStyle createImageBitmap Blob Response URL URLSearchParams Event EventTarget HTMLElement Path2D " +
  "CSSStyleSheet ResizeObserver IntersectionObserver DecompressionStream TransformStream TextDecoder TextEncoder";

export default [
  js.configs.recommended,
  {
    files: ["source/*.js", "page/rerun/viewer.js"],
    languageOptions: { globals: names(`${DATA} ${BROWSER}`) },
    rules: {
      eqeqeq: "error", "no-var": "error", "prefer-const": ["error", { destructuring: "all" }], "no-shadow": "error",
      "no-unused-expressions": ["error", { allowShortCircuit: true }], "no-eval": "error", "no-implied-eval": "error",
      "max-len": ["error", { code: 150 }],
    },
  },
  { files: ["tests/*.js"], languageOptions: { globals: names("Buffer") } },
  { files: ["page/rerun/viewer.js"], languageOptions: { sourceType: "script" } },
  { ignores: ["page/page.js", "node_modules"] },
];
