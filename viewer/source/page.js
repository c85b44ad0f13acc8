// The page: its parts, and what connects them.

import { Actors } from "./actors.js";
import { Camera } from "./camera.js";
import { Clock, clockTime, merged } from "./clock.js";
import { unpack } from "./data.js";
import { byId, element, letterMark, press, swatch, write } from "./elements.js";
import { Ground } from "./ground.js";
import { CameraImages } from "./images.js";
import { BEFORE, Incidents, counted } from "./incidents.js";
import { Part } from "./part.js";
import { Pictures } from "./pictures.js";
import { Plots } from "./plots.js";
import { Pointing } from "./pointing.js";
import { APART, Recorded, pair } from "./recorded.js";
import { copy, savePicture } from "./sharing.js";
import { Space } from "./space.js";
import { Stage } from "./stage.js";
import { theme } from "./theme.js";
import { Transport } from "./transport.js";

const AFTER = 3; // s after an incident up to which it is played
const LONGEST = 6; // s of an incident that are played; blocked actors stand for long
const LINGER = 2; // s after the beginning of an incident in which its text is shown
const ABSENT = -1; // instead of the id of an actor that a recording does not have
const CLOSE_VIEW = 56; // m, the width of the view
const TOAST = 2500; // ms for which a message is to be seen
const NARROW = window.matchMedia("(max-width: 700px)");

class Replay {
  /** @param {Recorded[]} recordings @param {GroundData} ground @param {(Images | null)[]} images */
  constructor(recordings, ground, images) {
    this.recordings = recordings;
    this.recording = recordings[0];
    this.tracks = this.recording.tracks;
    const moments = [...new Set(recordings.flatMap(({ tracks }) => [...tracks.times]))].sort((a, b) => a - b);
    this.clock = new Clock(merged(recordings.map(({ tracks }) => tracks.spans)), moments);
    const { x, y } = this.tracks;
    this.ground = new Ground(ground, x.length ? { x: x[0], y: y[0] } : { x: 0, y: 0 });
    this.stages = recordings.map((recording, i) => {
      const canvas = /** @type {HTMLCanvasElement} */ (byId(["canvas", "other-canvas"][i]));
      return new Stage(canvas, [recording], new Camera(), this.ground);
    });
    this.stage = this.stages[0];
    this.camera = this.stage.camera;
    this.help = /** @type {HTMLDialogElement} */ (byId("help"));
    this.mode = "";
    this.ends = /** @type {HTMLElement[]} */ ([]); // where it is said that a recording has ended
    this.part = new Part(Math.max(this.clock.stop, ...recordings.map(({ report }) => report.duration ?? 0)));
    this.incidents = new Incidents(recordings, new Pictures(this.ground), (i) => this.open(i), () => this.transport.addMarks());
    this.transport = new Transport(this.clock, this.part, this.incidents, (i) => this.open(i));
    this.plots = new Plots(recordings, this.part, { seek: (time) => this.clock.seek(time), changed: () => this.changed() });
    this.space = new Space(this.recording.report, () => this.changed());
    this.images = new CameraImages(images, recordings, () => this.changed());
    this.jumps = -1;
    this.last = 0; // ms
    this.stale = true;
    this.linked = "";
    this.begun = "";
    this.linking = this.toasting = 0; // timers
    for (const stage of this.stages) {
      /** @param {() => void} move */
      const moved = (move) => {
        move();
        this.link(stage);
      };
      new Pointing(stage.canvas, {
        drag: (right, down) => moved(() => stage.camera.pan(right, down)),
        zoom: (factor, left, top) => moved(() => stage.camera.zoom(factor, left, top)),
        hover: (left, top) => stage.hover(left, top) && this.changed(),
        click: (left, top) => {
          const actor = stage.actorAt(left, top);
          if (actor >= 0) this.follow(stage.tracks.actors[actor].id, { recording: stage.recording });
        },
      });
    }
    if (NARROW.matches) this.togglePlots();
    this.summarise();
    if (recordings.length > 1) this.compare();
    this.actors = new Actors(recordings, (recording, actor) => this.choose(recording, actor), () => this.changed());
    this.listen();
  }

  summarise() {
    const reports = this.recordings.map(({ report }) => report);
    const [{ map, program, duration, frames, version, kinds }] = reports;
    document.title = `${map || "Recording"} · ${reports.map(({ source }) => source).join(" and ")}`;
    byId("map").textContent = map || "No map name";
    const origin = byId("origin");
    if (reports.length > 1) {
      this.recordings.forEach(({ letter, report }) => {
        const length = report.duration === null ? "" : ` · ${clockTime(report.duration)}`;
        const text = element("span", "", `${report.source}${length} · ${counted(report.incidents.length)}`);
        origin.append(element("span", "source", "", [letterMark(letter), text]));
      });
    } else {
      origin.textContent = `${reports[0].source} · ${dateText(reports[0].date)}`;
    }
    const facts = byId("facts");
    /** @param {string} name @param {...(string | Node)} values */
    const add = (name, ...values) => {
      facts.append(element("div", name === "Actors" ? "" : "minor", "", [element("dt", "", name), element("dd", "", "", values)]));
    };
    if (reports.length === 1) {
      add("Duration", duration === null ? "unknown" : clockTime(duration));
      add("Frames", frames.toLocaleString("en"));
      add("CARLA format", String(version));
    }
    const shown = kinds.map(([kind, count, color]) => {
      return element("span", "kind", "", [swatch(color), element("b", "", String(count)), ` ${kind}${count === 1 || kind === "other" ? "" : "s"}`]);
    });
    add("Actors", ...(shown.length ? shown : ["none"]));
    byId("program").textContent = program;
    const notes = this.recording.report.opening?.notes ?? []; // what the page is about, such as broken rules
    byId("notes").append(...notes.map((note) => element("li", "", note)));
    byId("notes").hidden = !notes.length;
  }

  /** Set up the comparison of two recordings. */
  compare() {
    const [first, second] = this.recordings;
    pair(first, second);
    const { differences } = first.report;
    byId("difference").textContent = `${differences?.text}.`;
    this.transport.difference = differences?.since ?? null;
    this.transport.showPart();
    byId("compare").hidden = false;
    document.body.classList.add("compares");
    byId("other-speed-line").hidden = false;
    this.setMode(differences?.over || NARROW.matches ? "over" : "beside");
  }

  /** Show two recordings side by side, or over each other. @param {string} mode */
  setMode(mode) {
    if (this.recordings.length < 2) return;
    this.mode = mode;
    const beside = mode === "beside";
    byId("other-pane").hidden = !beside;
    byId("panes").classList.toggle("two", beside);
    for (const id of ["beside", "over"]) press(id, id === mode);
    this.stage.show(beside ? [this.recordings[0]] : this.recordings);
    this.ends = this.recordings.map(() => element("span", "ended"));
    const names = this.recordings.map(({ letter, report }, i) => [letterMark(letter), element("span", "", report.source), this.ends[i]]);
    byId("pane-name").replaceChildren(...(beside ? names[0] : names.flat()));
    byId("other-pane-name").replaceChildren(...(beside ? names[1] : []));
    this.link(this.stage);
    this.resize();
  }

  get active() {
    return this.mode === "beside" ? this.stages : [this.stage];
  }

  /** What can be done: by a click on the button with an id, by keys, or by both; the help lists it under the first key. */
  get actions() {
    const { camera, clock, help, images, part, space, transport } = this;
    /** @type {{ id?: string, keys: string[], name: string, run: () => void, off?: boolean }[]} */
    const actions = [
      { id: "play", keys: ["Space", "k"], name: "Play or pause", run: () => clock.toggle() },
      { keys: ["←"], name: "1 second back; with Shift a tenth", run: () => {} },
      { keys: ["→"], name: "1 second on; with Shift a tenth", run: () => {} },
      { id: "back", keys: [","], name: "One frame back", run: () => clock.step(-1) },
      { id: "forth", keys: ["."], name: "One frame on", run: () => clock.step(1) },
      { id: "previous", keys: ["p"], name: "Previous incident", run: () => this.step(-1) },
      { id: "next", keys: ["n"], name: "Next incident", run: () => this.step(1) },
      { keys: ["<"], name: "Slower", run: () => transport.changePace(-1) },
      { keys: [">"], name: "Faster", run: () => transport.changePace(1) },
      { keys: ["z"], name: "Zoom into the timeline", run: () => part.zoom(2, clock.time) },
      { keys: ["x"], name: "Zoom out of the timeline", run: () => part.zoom(0.5, clock.time) },
      { keys: ["a", "/"], name: "Search actors", run: () => this.actors.startSearch() },
      { id: "release", keys: ["Escape"], name: "Stop following", run: () => this.follow(null) },
      { id: "heading", keys: ["h"], name: "Turn with the followed actor", run: () => this.toggle("heading", camera.turns) },
      { id: "closer", keys: ["+", "="], name: "Zoom in", run: () => this.zoom(1.25) },
      { id: "farther", keys: ["-", "−"], name: "Zoom out", run: () => this.zoom(0.8) },
      { id: "fit", keys: ["f"], name: "Show everything", run: () => this.fit() },
      { id: "labels", keys: ["l"], name: "Names", run: () => this.toggle("labels", this.stage.labels) },
      { id: "trails", keys: ["t"], name: "Trails", run: () => this.toggle("trails", this.stage.trails) },
      { id: "curves", keys: ["g"], name: "Plots", run: () => this.togglePlots() },
      { id: "images", keys: ["i"], name: "Camera", run: () => images.toggle(), off: images.button.hidden },
      { id: "copy", keys: ["y"], name: "Copy a link to this moment", run: () => this.copyLink() },
      { id: "save", keys: ["s"], name: "Save a picture of the view", run: () => this.savePicture() },
      { id: "theme", keys: ["d"], name: "Light or dark", run: () => theme.toggle() },
      { id: "beside", keys: [], name: "Side by side (C)", run: () => this.setMode("beside") },
      { id: "over", keys: [], name: "Overlaid (C)", run: () => this.setMode("over") },
      { keys: ["c"], name: "Side by side or overlaid", run: () => this.setMode(this.mode === "beside" ? "over" : "beside"), off: !this.mode },
      { id: "solid", keys: ["v"], name: "View in 3D", run: () => space.toggle(), off: space.button.hidden },
      { id: "keys", keys: ["?"], name: "Keyboard shortcuts", run: () => help.showModal() },
    ];
    return actions.filter(({ off }) => !off);
  }

  listen() {
    const shown = /** @type {Record<string, string>} */ ({ Escape: "Esc", "-": "−" });
    for (const { id, keys: [key], name, run } of this.actions) {
      const sign = key && (shown[key] ?? (key.length === 1 ? key.toUpperCase() : key));
      if (sign) byId("shortcuts").append(element("div", "", "", [element("dt", "", "", [element("kbd", "", sign)]), element("dd", "", name)]));
      if (!id) continue;
      const button = byId(id);
      button.addEventListener("click", run);
      if (!button.textContent?.trim()) button.setAttribute("aria-label", name);
      button.title ||= sign ? `${name} (${sign})` : name;
    }
    this.clock.addEventListener("seek", () => this.changed());
    this.clock.addEventListener("state", () => this.changed());
    this.part.addEventListener("change", () => this.changed());
    theme.addEventListener("change", () => this.drawStages());
    document.addEventListener("keydown", (event) => this.key(event));
    document.addEventListener("click", ({ detail, target }) => {
      const button = /** @type {Element} */ (target).closest("button");
      if (detail) button?.blur(); // pressed by a pointer, so that Space plays and pauses
    });
    window.addEventListener("hashchange", () => this.readLink());
    const observer = new ResizeObserver(() => this.resize());
    for (const stage of this.stages) observer.observe(stage.canvas);
    observer.observe(this.plots.frame);
  }

  /** Use the room of the window. */
  resize() {
    for (const stage of this.active) stage.resize();
    this.drawStages(); // resizing clears the canvas, which is painted before the next frame
    this.plots.refresh();
    this.changed();
  }

  drawStages() {
    for (const stage of this.active) {
      stage.camera.step(this.focus(stage), 0, true);
      stage.draw(this.clock.time);
    }
  }

  /** Show the beginning, or the time and actor in the address. */
  start() {
    for (const stage of this.active) stage.resize();
    this.follow(this.recording.report.follow, { quiet: true });
    for (const { camera } of this.stages) camera.show(CLOSE_VIEW * 1.5);
    if (this.focus(this.stage) === null) {
      this.stage.draw(this.clock.time);
      this.fit();
    }
    this.showOpening();
    this.begun = this.address(); // is left out of the address
    this.readLink();
    this.changed();
  }

  /** Show the moment that the page is about: the incident that begins then, or else what happens from a little before. */
  showOpening() {
    const { time = null, actors = [] } = this.recording.report.opening ?? {};
    if (time === null) return;
    const index = this.incidents.items.findIndex(({ start, incident }) => Math.abs(start - time) < 0.01 && incident.actors.join() === actors.join());
    if (this.incidents.items[index]?.replayed) {
      this.open(index, { play: false });
      return;
    }
    this.clock.seek(Math.max(0, time - BEFORE));
    if (actors.length && this.tracks.byId.has(actors[0])) this.follow(actors[0], { quiet: true });
  }

  /** Play through an incident, from shortly before it to shortly after it, and follow the first of its actors. @param {number} index */
  open(index, { play = true } = {}) {
    const item = this.incidents.items[index];
    if (!item || !item.replayed) return;
    const { incident, recording } = item;
    this.incidents.choose(index);
    const [start, stop] = this.shownAround(item);
    if (play) this.clock.playThrough(start, stop);
    else this.clock.seek(start);
    const present = incident.actors.find((id) => recording.poseOf(id, this.clock.time) !== null);
    this.follow(present ?? null, { recording, quiet: true });
    for (const { camera } of this.stages) {
      if (present === undefined && incident.place) [camera.x, camera.y] = incident.place;
      camera.show(CLOSE_VIEW);
    }
    this.say(`Incident ${index + 1} of ${this.incidents.items.length}: ${incident.text}`);
  }

  /** Return the time from which an incident is played, and up to which. @param {Item} item */
  shownAround({ start, incident }) {
    return [Math.max(0, start - BEFORE), Math.min(incident.stop ?? start, start + LONGEST) + AFTER];
  }

  /** @param {number} direction */
  step(direction) {
    const index = this.incidents.neighbour(direction, this.clock.time);
    if (index >= 0) this.open(index);
  }

  /** Follow an actor that was chosen from the list, from its beginning if it is absent. @param {Recorded} recording @param {number} actor */
  choose(recording, actor) {
    const { tracks } = recording;
    const isThere = tracks.trackAt(actor, tracks.sampleAt(this.clock.time)) >= 0;
    if (!isThere) this.clock.seek(tracks.times[tracks.firsts[actor][0]]);
    this.follow(tracks.actors[actor].id, { recording });
    for (const { camera } of this.stages) camera.show(CLOSE_VIEW);
  }

  /** Follow the actor with an id in a recording, and the same one in the other recording. @param {number | null} id */
  follow(id, { recording = this.recording, quiet = false } = {}) {
    const actor = id === null ? -1 : recording.tracks.indexOf(id, this.clock.time);
    for (const { camera, recording: shown } of this.stages) {
      if (id === null || shown === recording) camera.followed = id;
      else camera.followed = shown.tracks.actors[recording.twin(actor)]?.id ?? ABSENT;
    }
    if (!quiet) this.say(id === null ? "No actor is followed" : `Following ${recording.tracks.actors[actor]?.label ?? id}`);
    this.changed();
  }

  /** The ids of the followed actor in each recording, `ABSENT` where it is not; null if none is followed. */
  get followed() {
    return this.camera.followed === null ? null : this.stages.map(({ camera }) => camera.followed ?? ABSENT);
  }

  /** Give all cameras the view of a stage's. @param {Stage} stage */
  link(stage) {
    for (const { camera } of this.stages) {
      [camera.scale, camera.turns] = [stage.camera.scale, stage.camera.turns];
      if (stage.camera.followed !== null) continue;
      camera.followed = null;
      [camera.x, camera.y, camera.up] = [stage.camera.x, stage.camera.y, stage.camera.up];
    }
    this.changed();
  }

  fit() {
    for (const stage of this.stages) stage.camera.fit(this.stage.bounds);
    this.changed();
  }

  /** @param {number} factor */
  zoom(factor) {
    for (const { camera } of this.stages) camera.zoom(factor);
    this.changed();
  }

  /** @param {"heading" | "labels" | "trails"} what @param {boolean} before whether it is on */
  toggle(what, before) {
    for (const stage of this.stages) {
      if (what === "heading") stage.camera.turns = !before;
      else stage[what] = !before;
    }
    press(what, !before);
    this.changed();
  }

  togglePlots() {
    this.plots.frame.hidden = this.plots.isOpen;
    press("curves", this.plots.isOpen);
    this.plots.refresh();
    this.changed();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.help.open) return;
    const target = /** @type {Element} */ (event.target);
    if (target.matches("select") || (event.key === " " && target.matches("button"))) return; // they use the key
    const onCanvas = this.stages.some(({ canvas }) => target === canvas);
    const arrow = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    const name = event.key === " " ? "Space" : event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const action = this.actions.find(({ keys }) => keys.includes(name));
    if (arrow && onCanvas) {
      this.camera.pan(60 * arrow[0], 60 * arrow[1]);
      this.link(this.stage);
    } else if (arrow?.[0]) {
      this.clock.seek(Math.max(0, this.clock.time - arrow[0] * (event.shiftKey ? 0.1 : 1)));
    } else if (action) {
      action.run();
    } else {
      return;
    }
    event.preventDefault();
  }

  /** Return the poses of the followed actor in each recording; null where it is absent. */
  followedPoses() {
    const { followed } = this;
    return this.recordings.map((recording, index) => followed && recording.poseOf(followed[index], this.clock.time));
  }

  /** Return the pose that the camera of a stage follows; null if there is none. @param {Stage} stage */
  focus(stage) {
    const poses = this.followedPoses();
    const own = poses[stage.recording.index];
    const other = poses.length > 1 ? poses[1 - stage.recording.index] : null;
    if (!own || !other || this.mode === "beside") return own ?? other;
    // Between both, as long as the first one stays well in sight.
    const [x, y] = [(other.x - own.x) / 2, (other.y - own.y) / 2];
    const { width, height, scale } = stage.camera;
    const part = Math.min(1, (0.3 * Math.min(width, height)) / scale / Math.max(1e-6, Math.hypot(x, y)));
    return { x: own.x + part * x, y: own.y + part * y, yaw: own.yaw };
  }

  /** Request another drawing. */
  changed() {
    if (this.stale) return;
    this.stale = true;
    requestAnimationFrame((now) => this.draw(now));
  }

  /** @param {number} now in ms */
  draw(now) {
    const seconds = Math.min(0.1, Math.max(0, (now - this.last) / 1000));
    this.last = now;
    this.stale = false;
    if (this.clock.playing) this.clock.tick(seconds);
    const jumped = this.jumps !== this.clock.jumps;
    this.jumps = this.clock.jumps;
    let turning = false;
    for (const stage of this.active) turning = stage.camera.step(this.focus(stage), seconds, jumped) || turning;
    if (this.space.isOpen) this.space.show(this.clock.time, this.followedActor());
    else for (const stage of this.active) stage.draw(this.clock.time);
    this.plots.draw(this.clock.time, this.followed);
    this.images.show(this.clock.time);
    this.transport.showTime();
    this.part.show(this.clock.time, this.clock.playing);
    this.actors.show(this.clock.time, this.followed);
    this.showFollowed();
    this.showCaption();
    this.showRule();
    this.showEnds();
    this.writeLink();
    if (this.clock.playing || turning) this.changed();
  }

  showFollowed() {
    const { time } = this.clock;
    const actor = this.followedActor();
    byId("followed").hidden = !actor;
    /** @type {HTMLButtonElement} */ (byId("heading")).disabled = !actor;
    if (!actor) return;
    /** @param {string} id @param {string} text */
    const set = (id, text) => write(byId(id), text);
    byId("followed-color").style.background = actor.color;
    set("followed-name", actor.label);
    set("followed-type", [actor.type || actor.kind, actor.role && actor.role !== "hero" ? actor.role : ""].filter(Boolean).join(" · "));
    const poses = this.followedPoses();
    this.recordings.forEach(({ tracks }, index) => {
      const there = poses[index] && tracks.covers(time);
      const speed = there ? tracks.speed(tracks.indexOf(this.followed?.[index], time), time) * 3.6 : NaN;
      set(index ? "other-speed" : "speed", Number.isNaN(speed) ? "–" : speed.toFixed(0));
    });
    const apart = poses.length > 1 && poses[0] && poses[1] ? Math.hypot(poses[0].x - poses[1].x, poses[0].y - poses[1].y) : 0;
    set("apart", apart > APART ? `${apart.toFixed(1)} m apart` : "");
  }

  /** Return the followed actor, as one of the recordings has it; null if none is followed. */
  followedActor() {
    const found = this.recordings.map((recording, index) => recording.actor(this.followed?.[index], this.clock.time));
    return found.find((actor) => actor !== null) ?? null;
  }

  /** Show the text of the chosen incident around it, or else of the latest one. */
  showCaption() {
    const { time } = this.clock;
    const chosen = this.incidents.items[this.incidents.current];
    const isNear = chosen?.replayed && chosen.start - BEFORE - 0.05 <= time && time <= this.shownAround(chosen)[1] + 0.05;
    const shown = isNear ? chosen : this.incidents.latestIn(time - LINGER - 0.05, time + 0.05);
    const caption = byId("caption");
    caption.hidden = !shown;
    if (!shown) return;
    const ahead = shown.start - time;
    const other = this.recordings.find((recording) => recording !== shown.recording);
    const text = (other && !other.has(shown.incident) ? `${shown.recording.letter}: ` : "") + shown.incident.text;
    write(byId("caption-text"), text);
    write(byId("caption-when"), ahead > 0.05 ? `in ${ahead.toFixed(1)} s` : "");
    caption.dataset.kind = shown.kind;
  }

  showRule() {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((m) => m * this.camera.scale >= 56) ?? 1e4;
    byId("rule").style.width = `${metres * this.camera.scale}px`;
    byId("rule-length").textContent = metres < 1000 ? `${metres} m` : `${metres / 1000} km`;
  }

  /** Show which of two recordings has ended. */
  showEnds() {
    this.ends.forEach((end, index) => {
      const stop = this.recordings[index].tracks.times.at(-1) ?? 0;
      write(end, this.clock.time > stop + 0.1 ? `ended at ${clockTime(stop)}` : "");
    });
  }

  /** Say something to screen readers, and with `aloud` show it, too. @param {string} text */
  say(text, aloud = false) {
    const status = byId("status");
    status.textContent = text;
    status.className = aloud ? "toast" : "unseen";
    clearTimeout(this.toasting);
    if (aloud) this.toasting = window.setTimeout(() => (status.className = "unseen"), TOAST);
  }

  /** Copy a link to the moment. */
  async copyLink() {
    const address = new URL(this.address(), location.href).href;
    this.say((await copy(address)) ? "The link to this moment is copied" : "The browser does not permit to copy the link", true);
  }

  /** Save what is seen from above as a picture. */
  async savePicture() {
    if (this.space.isOpen) return this.say("Only the view from above can be saved", true);
    const { map, source } = this.recording.report;
    const { time } = this.clock;
    const caption = byId("caption").hidden ? [] : [byId("caption").textContent ?? ""];
    const line = [map, ...this.recordings.map(({ report }) => report.source), clockTime(time, 2), ...caption].filter(Boolean).join(" · ");
    await savePicture(this.active, line, `${source.replace(/\.\w+$/, "")}-${time.toFixed(2)}s.png`);
    return this.say("A picture of the view is saved", true);
  }

  readLink() {
    if (location.hash === this.linked) return;
    const words = new URLSearchParams(location.hash.slice(1));
    /** @param {string} name */
    const number = (name) => (words.get(name) && Number.isFinite(Number(words.get(name))) ? Number(words.get(name)) : null);
    const [incident, time, id] = [number("incident"), number("t"), number("follow")];
    const mode = words.get("view") ?? "";
    if (["beside", "over"].includes(mode)) this.setMode(mode);
    if (incident !== null) this.open(incident - 1, { play: time === null });
    if (time !== null) this.clock.seek(Math.max(0, time));
    if (id !== null && this.tracks.byId.has(id)) this.follow(id, { quiet: true });
    if (time !== null && incident === null) this.incidents.choose(-1);
    this.linked = location.hash;
  }

  address() {
    const { followed } = this.camera;
    const { time } = this.clock;
    const { items, current } = this.incidents;
    const words = [`t=${Number(time.toFixed(2))}`];
    if (items[current]) {
      const [start, stop] = this.shownAround(items[current]);
      if (start - 0.1 <= time && time <= stop + 0.1) words.unshift(`incident=${current + 1}`);
    }
    if (followed !== null && followed !== ABSENT) words.push(`follow=${followed}`);
    if (this.mode === "over") words.push("view=over");
    return `#${words.join("&")}`;
  }

  writeLink() {
    const address = this.address();
    if (this.clock.playing || address === this.linked || (address === this.begun && !this.linked)) return;
    this.linked = address;
    clearTimeout(this.linking);
    this.linking = window.setTimeout(() => history.replaceState(null, "", address), 250);
  }
}

/** Return the date and time of a recording in words. @param {string | null} date */
function dateText(date) {
  const day = date && new Date(date);
  if (!day || !Number.isFinite(day.getTime())) return "no date";
  return `${day.toLocaleString("en-GB", { dateStyle: "long", timeStyle: "short", timeZone: "UTC" })} UTC`;
}

Promise.all([unpack(GROUND), ...RECORDINGS.map(unpack)]).then(([ground, ...data]) => {
  const replay = new Replay(data.map((each, index) => new Recorded(index, REPORTS[index], each)), ground, IMAGES);
  Object.assign(globalThis, { replay, theme }); // for the console
  replay.stale = false;
  replay.start();
  replay.draw(performance.now());
  performance.mark("recap-first-frame");
}).catch((error) => {
  const sign = byId("nothing");
  sign.textContent = `This page cannot be shown: ${error.message}. It needs a browser from 2023 or later.`;
  sign.hidden = false;
  throw error;
});
