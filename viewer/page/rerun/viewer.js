// Rerun's viewer, which shows the time and the actor that the surrounding page requests.
"use strict";

const SET_TIME = 6; // an operation of Rerun's viewer_control.proto
const PAUSED = 1;
const BILLION = 1e9; // ns
const RETRY = 200; // ms
const CONFIRMATIONS = [300, 1000, 3000, 8000]; // ms

/** Return an integer in protobuf's encoding. @param {number} value */
function varint(value) {
  const bytes = [];
  let rest = BigInt.asUintN(64, BigInt(value));
  for (; rest > 127n; rest >>= 7n) bytes.push(Number(rest & 127n) | 128);
  return [...bytes, Number(rest)];
}

/** Return a field with a message or a text. @param {number} field @param {ArrayLike<number> & Iterable<number>} bytes */
function block(field, bytes) {
  return [...varint(field * 8 + 2), ...varint(bytes.length), ...bytes];
}

/** Return the request to show a time of a timeline, paused. @param {string} timeline @param {number} seconds */
function timeRequest(timeline, seconds) {
  const name = block(1, new TextEncoder().encode(timeline));
  const time = [8, ...varint(Math.round(seconds * BILLION))];
  return new Uint8Array(block(SET_TIME, [...block(2, name), ...block(3, time), 40, PAUSED]));
}

/** @typedef {{ time: number, camera: string | null }} Wanted */

class Viewer {
  /** @param {{ viewer_control(request: Uint8Array): Promise<unknown>, add_receiver(url: string): void }} handle */
  constructor(handle) {
    this.handle = handle;
    this.wanted = /** @type {Wanted | null} */ (null);
    this.camera = /** @type {string | null} */ (null); // null: the recording's own blueprint
    this.time = /** @type {number | null} */ (null); // the time that is shown, in s
    this.asked = 0; // the time that was requested last
    this.timers = /** @type {number[]} */ ([]);
    this.busy = false;
  }

  /** Show a time, from a camera: the address of a blueprint, or null to keep the present one. @param {Wanted} wanted */
  show(wanted) {
    this.wanted = wanted;
    if (!this.busy) this.work();
  }

  /** Apply the latest request, until no other has arrived. */
  async work() {
    this.busy = true;
    while (this.wanted) {
      const { time, camera } = this.wanted;
      this.wanted = null;
      this.asked = time;
      if (camera && camera !== this.camera) {
        this.camera = camera;
        this.confirm();
        this.handle.add_receiver(new URL(camera, location.href).href);
      }
      try {
        await this.handle.viewer_control(timeRequest("sim_time", time));
        this.time = time;
      } catch {
        await new Promise((resolve) => setTimeout(resolve, RETRY)); // the recording is being loaded
        this.wanted ??= { time, camera };
      }
    }
    this.busy = false;
  }

  /** Request the time again while a blueprint is loaded, which may set another one. */
  confirm() {
    this.timers.forEach(clearTimeout);
    this.timers = CONFIRMATIONS.map((late) => window.setTimeout(() => this.show({ time: this.asked, camera: this.camera }), late));
  }
}

/** Return the answer with the viewer's program, and report to the surrounding page how much of it is loaded. */
async function program() {
  const answer = await fetch("re_viewer_bg.wasm");
  const whole = Number(answer.headers.get("Content-Length"));
  if (!answer.ok || !answer.body || !whole) return answer;
  let loaded = 0;
  const counted = new TransformStream({
    transform(chunk, controller) {
      loaded += chunk.length;
      window.parent.postMessage({ loaded: Math.min(1, loaded / whole) }, location.origin);
      controller.enqueue(chunk);
    },
  });
  return new Response(answer.body.pipeThrough(counted), { headers: { "Content-Type": "application/wasm" } });
}

async function start() {
  await wasm_bindgen({ module_or_path: program() });
  const handle = new wasm_bindgen.WebHandle({
    url: [new URL("recording.rrd", location.href).href],
    hide_welcome_screen: true,
    panel_state_overrides: { top: "Hidden", blueprint: "Hidden", selection: "Hidden", time: "Hidden" },
    enable_history: false,
    persist: false,
    theme: "dark",
    render_backend: "webgl",
  });
  await handle.start(document.getElementById("space"));
  /** @type {HTMLElement} */ (document.getElementById("state")).hidden = true;
  return new Viewer(handle);
}

const starting = start();
window.addEventListener("message", (event) => {
  if (event.source === window.parent && event.origin === location.origin) starting.then((viewer) => viewer.show(event.data));
});
starting.then(
  () => window.parent.postMessage({ ready: true }, location.origin),
  (error) => {
    /** @type {HTMLElement} */ (document.getElementById("state")).textContent = `Rerun's viewer does not start: ${error}`;
    window.parent.postMessage({ failed: true }, location.origin);
  },
);
