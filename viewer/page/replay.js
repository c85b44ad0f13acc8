// The page: its parts, and what connects them.
"use strict";

const BEFORE = 3; // s before an incident at which it is played from
const AFTER = 3; // s after it
const LONGEST = 6; // s of an incident that are played; blocked actors stand for long
const LINGER = 2; // s after the beginning of an incident in which its text is shown
const ABSENT = -1; // instead of the id of an actor that a recording does not have
const CLOSE_VIEW = 56; // m, the width of the view
const NARROW = window.matchMedia("(max-width: 700px)");

class Replay {
  constructor(recordings, ground, images) {
    this.recordings = recordings;
    [this.recording] = recordings;
    this.tracks = this.recording.tracks;
    this.clock = new Clock(merged(recordings.map(({ tracks }) => tracks.spans)));
    const { x, y } = this.tracks;
    this.ground = new Ground(ground, x.length ? { x: x[0], y: y[0] } : { x: 0, y: 0 });
    const canvases = ["canvas", "other-canvas"].slice(0, recordings.length);
    this.stages = canvases.map((id, i) => new Stage(document.getElementById(id), [recordings[i]], new Camera(), this.ground));
    [this.stage] = this.stages;
    this.camera = this.stage.camera;
    this.length = Math.max(this.clock.stop, ...recordings.map(({ report }) => report.duration ?? 0));
    this.incidents = new Incidents(recordings, new Pictures(this.ground), (i) => this.open(i), () => this.transport.addMarks());
    this.transport = new Transport(this.clock, this.length, this.incidents, (i) => this.open(i));
    this.plots = new Plots(recordings, this.length, (time) => this.clock.seek(time));
    this.space = new Space(this.recording.report, () => this.changed());
    this.images = new CameraImages(images, recordings, () => this.changed());
    this.jumps = -1;
    this.last = 0; // ms
    this.stale = true;
    this.linked = "";
    for (const stage of this.stages) {
      new Pointing(stage, {
        pick: (actor) => this.follow(stage.tracks.actors[actor].id, { recording: stage.recording }),
        view: () => this.link(stage),
      });
    }
    if (NARROW.matches) this.togglePlots();
    this.summarise();
    if (recordings.length > 1) this.compare();
    this.note();
    this.listen();
  }

  // --- what is written once -------------------------------------------------------------------------------

  summarise() {
    const reports = this.recordings.map(({ report }) => report);
    const [{ map, program }] = reports;
    document.title = `${map || "Recording"} · ${reports.map(({ source }) => source).join(" and ")}`;
    document.getElementById("map").textContent = map || "No map name";
    const origin = document.getElementById("origin");
    if (reports.length > 1) {
      this.recordings.forEach(({ letter, report }) => {
        const length = report.duration === null ? "" : ` · ${clockTime(report.duration)}`;
        const text = element("span", "", `${report.source}${length} · ${counted(report.incidents.length)}`);
        origin.append(element("span", "source", "", [element("i", `letter of-${letter}`, letter), text]));
      });
    } else {
      origin.textContent = `${reports[0].source} · ${dateText(reports[0].date)}`;
    }
    const facts = document.getElementById("facts");
    const add = (name, ...values) => {
      facts.append(element("div", name === "Actors" ? "" : "minor", "", [element("dt", "", name), element("dd", "", "", values)]));
    };
    const [{ duration, frames, version, kinds }] = reports;
    if (reports.length === 1) {
      add("Duration", duration === null ? "unknown" : clockTime(duration));
      add("Frames", frames.toLocaleString("en"));
      add("CARLA format", String(version));
    }
    const shown = kinds.map(([kind, count, color]) => {
      const swatch = element("i", "swatch");
      swatch.style.background = color;
      return element("span", "kind", "", [swatch, element("b", "", String(count)), ` ${plural(kind, count)}`]);
    });
    add("Actors", ...(shown.length ? shown : ["none"]));
    document.getElementById("program").textContent = program;
  }

  /** Show what the page is about, such as broken rules. */
  note() {
    const list = document.getElementById("notes");
    for (const note of this.recording.report.opening?.notes ?? []) list.append(element("li", "", note));
    list.hidden = !list.children.length;
  }

  /** Set up the comparison of two recordings. */
  compare() {
    const [first, second] = this.recordings;
    pair(first, second);
    const given = first.report.differences;
    const difference = given ? given.since : first.differsFrom(second);
    const text = difference === null ? "Both move alike." : `The same until ${clockTime(difference)}, different from then on.`;
    document.getElementById("difference").textContent = given ? `${given.text}.` : text;
    if (difference !== null) this.transport.addDifference(difference);
    document.getElementById("compare").hidden = false;
    document.body.classList.add("compares");
    document.querySelectorAll(".pane-name").forEach((name, index) => {
      const { letter, report } = this.recordings[index];
      name.append(element("i", `letter of-${letter}`, letter), element("span", "", report.source), element("span", "ended"));
      name.hidden = false;
    });
    document.querySelectorAll("#followed .speed").forEach((speed) => (speed.hidden = false));
    this.setMode(given || NARROW.matches ? "over" : "beside");
  }

  /** Show two recordings side by side, or over each other. */
  setMode(mode) {
    if (this.recordings.length < 2) return;
    this.mode = mode;
    const beside = mode === "beside";
    document.querySelectorAll(".pane")[1].hidden = !beside;
    document.querySelector(".panes").classList.toggle("two", beside);
    for (const id of ["beside", "over"]) document.getElementById(id).setAttribute("aria-pressed", String(id === mode));
    this.stage.show(beside ? [this.recordings[0]] : this.recordings);
    const names = document.querySelectorAll(".pane-name");
    names[0].classList.toggle("both", !beside);
    names[0].querySelectorAll(".more").forEach((node) => node.remove());
    for (const node of beside ? [] : names[1].children) {
      names[0].append(Object.assign(node.cloneNode(true), { className: `${node.className} more` }));
    }
    this.link(this.stage);
    this.resize();
  }

  get active() {
    return this.mode === "beside" ? this.stages : [this.stage];
  }

  listen() {
    const on = (id, action) => document.getElementById(id).addEventListener("click", action);
    on("fit", () => this.fit());
    on("closer", () => this.zoom(1.5));
    on("farther", () => this.zoom(1 / 1.5));
    on("heading", () => this.toggle("heading"));
    on("labels", () => this.toggle("labels"));
    on("trails", () => this.toggle("trails"));
    on("curves", () => this.togglePlots());
    on("theme", () => theme.toggle());
    on("beside", () => this.setMode("beside"));
    on("over", () => this.setMode("over"));
    on("keys", () => document.getElementById("help").showModal());
    on("release", () => this.follow(null));
    on("previous", () => this.step(-1));
    on("next", () => this.step(1));
    this.clock.addEventListener("seek", () => this.changed());
    this.clock.addEventListener("state", () => this.changed());
    theme.addEventListener("change", () => this.drawStages());
    document.addEventListener("keydown", (event) => this.key(event));
    document.addEventListener("click", ({ detail, target }) => {
      if (detail) target.closest("button:not(.incident)")?.blur(); // pressed by a pointer, so that Space plays and pauses
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
    const begins = ({ incident }) => Math.abs(incident.start - time) < 0.01 && incident.actors.join() === actors.join();
    const index = this.incidents.items.findIndex(begins);
    if (this.incidents.items[index]?.replayed) {
      this.open(index, { play: false });
      return;
    }
    this.clock.seek(Math.max(0, time - BEFORE));
    if (actors.length && this.tracks.byId.has(actors[0])) this.follow(actors[0], { quiet: true });
  }

  // --- actions ------------------------------------------------------------------------------------------

  /** Play through an incident, from shortly before it to shortly after it, and follow the first of its actors. */
  open(index, { play = true } = {}) {
    const item = this.incidents.items[index];
    if (!item || !item.replayed) return;
    const { incident, recording } = item;
    this.incidents.choose(index);
    const [start, stop] = this.shownAround(incident);
    if (play) this.clock.playThrough(start, stop);
    else this.clock.seek(start);
    const present = incident.actors.find((id) => recording.poseOf(id, this.clock.time) !== null);
    this.follow(present ?? null, { recording, quiet: true });
    for (const { camera } of this.stages) {
      if (present === undefined && incident.place[0] !== null && incident.place[1] !== null) {
        [camera.x, camera.y] = incident.place;
      }
      camera.show(CLOSE_VIEW);
    }
    this.say(`Incident ${index + 1} of ${this.incidents.items.length}: ${incident.text}`);
  }

  /** Return the time from which an incident is played, and up to which. */
  shownAround({ start, stop }) {
    return [Math.max(0, start - BEFORE), Math.min(stop ?? start, start + LONGEST) + AFTER];
  }

  step(direction) {
    const index = this.incidents.neighbour(direction);
    if (index >= 0) this.open(index);
  }

  /** Follow the actor with an id in a recording, and the same one in the other recording. */
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
    return this.camera.followed === null ? null : this.stages.map(({ camera }) => camera.followed);
  }

  /** Give all cameras the view of a stage's. */
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

  zoom(factor) {
    for (const { camera } of this.stages) camera.zoom(factor);
    this.changed();
  }

  toggle(what) {
    for (const stage of this.stages) {
      if (what === "heading") stage.camera.turns = !stage.camera.turns;
      else stage[what] = !stage[what];
    }
    const pressed = what === "heading" ? this.camera.turns : this.stage[what];
    document.getElementById(what).setAttribute("aria-pressed", String(pressed));
    this.changed();
  }

  togglePlots() {
    this.plots.frame.hidden = this.plots.isOpen;
    document.getElementById("curves").setAttribute("aria-pressed", String(this.plots.isOpen));
    this.plots.refresh();
    this.changed();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || document.getElementById("help").open) return;
    const { target } = event;
    const onCanvas = this.stages.some(({ canvas }) => target === canvas);
    if (target.matches("select")) return;
    const seconds = event.shiftKey ? 0.1 : 1;
    const pan = (right, down) => () => {
      this.camera.pan(right, down);
      this.link(this.stage);
    };
    const seek = (step) => () => this.clock.seek(Math.max(0, this.clock.time + step));
    const actions = {
      " ": () => this.clock.toggle(),
      k: () => this.clock.toggle(),
      ArrowLeft: onCanvas ? pan(60, 0) : seek(-seconds),
      ArrowRight: onCanvas ? pan(-60, 0) : seek(seconds),
      ArrowUp: onCanvas ? pan(0, 60) : null,
      ArrowDown: onCanvas ? pan(0, -60) : null,
      "+": () => this.zoom(1.25),
      "=": () => this.zoom(1.25),
      "-": () => this.zoom(0.8),
      "<": () => this.transport.changePace(-1),
      ",": () => this.transport.changePace(-1),
      ">": () => this.transport.changePace(1),
      ".": () => this.transport.changePace(1),
      n: () => this.step(1),
      p: () => this.step(-1),
      f: () => this.fit(),
      h: () => this.toggle("heading"),
      i: () => this.images.toggle(),
      l: () => this.toggle("labels"),
      t: () => this.toggle("trails"),
      g: () => this.togglePlots(),
      d: () => theme.toggle(),
      c: () => this.setMode(this.mode === "beside" ? "over" : "beside"),
      v: () => this.space.toggle(),
      "?": () => document.getElementById("help").showModal(),
      Escape: () => this.follow(null),
    };
    if (event.key === " " && target.matches("button")) return; // it presses the button
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  // --- drawing ------------------------------------------------------------------------------------------

  poseOf(id) {
    return this.recording.poseOf(id, this.clock.time);
  }

  /** Return the poses of the followed actor in each recording; null where it is absent. */
  followedPoses() {
    const { followed } = this;
    return this.recordings.map(({ index }) => followed && this.recordings[index].poseOf(followed[index], this.clock.time));
  }

  /** Return the pose that the camera of a stage follows; null if there is none. */
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
    document.getElementById("followed").hidden = !actor;
    document.getElementById("heading").disabled = !actor;
    if (!actor) return;
    const set = (id, text) => write(document.getElementById(id), text);
    document.getElementById("followed-color").style.background = actor.color;
    set("followed-name", actor.label);
    set("followed-type", [actor.type || actor.kind, actor.role && actor.role !== "hero" ? actor.role : ""].filter(Boolean).join(" · "));
    const poses = this.followedPoses();
    this.recordings.forEach(({ tracks }, index) => {
      const there = poses[index] && tracks.covers(time);
      const speed = there ? tracks.speed(tracks.indexOf(this.followed[index], time), time) * 3.6 : NaN;
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
    const { items, current } = this.incidents;
    const isShown = ({ replayed, incident }, early, late) => replayed && incident.start - early - 0.05 <= time && time <= late + 0.05;
    const chosen = items[current];
    const latest = items.findLast((item) => isShown(item, 0, item.incident.start + LINGER));
    const shown = chosen && isShown(chosen, BEFORE, this.shownAround(chosen.incident)[1]) ? chosen : latest;
    const caption = document.getElementById("caption");
    caption.hidden = !shown;
    if (!shown) return;
    const ahead = shown.incident.start - time;
    const other = this.recordings.find((recording) => recording !== shown.recording);
    const text = (other && !other.has(shown.incident) ? `${shown.recording.letter}: ` : "") + shown.incident.text;
    write(document.getElementById("caption-text"), text);
    write(document.getElementById("caption-when"), ahead > 0.05 ? `in ${ahead.toFixed(1)} s` : "");
    caption.dataset.kind = shown.kind;
  }

  showRule() {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((m) => m * this.camera.scale >= 56) ?? 1e4;
    document.getElementById("rule").style.width = `${metres * this.camera.scale}px`;
    document.getElementById("rule-length").textContent = metres < 1000 ? `${metres} m` : `${metres / 1000} km`;
  }

  /** Show which of two recordings has ended. */
  showEnds() {
    if (this.recordings.length < 2) return;
    for (const [number, name] of document.querySelectorAll(".pane-name").entries()) {
      for (const [more, end] of name.querySelectorAll(".ended").entries()) {
        const stop = this.recordings[number + more].tracks.times.at(-1) ?? 0;
        write(end, this.clock.time > stop + 0.1 ? `ended at ${clockTime(stop)}` : "");
      }
    }
  }

  say(text) {
    document.getElementById("status").textContent = text;
  }

  // --- the incident, the time and the followed actor in the address ---------------------------------------

  readLink() {
    if (location.hash === this.linked) return;
    const words = new URLSearchParams(location.hash.slice(1));
    const number = (name) => (words.get(name) && Number.isFinite(Number(words.get(name))) ? Number(words.get(name)) : null);
    const [incident, time, id] = [number("incident"), number("t"), number("follow")];
    if (["beside", "over"].includes(words.get("view"))) this.setMode(words.get("view"));
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
      const [start, stop] = this.shownAround(items[current].incident);
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
    this.linking = setTimeout(() => history.replaceState(null, "", address), 250);
  }
}

function plural(kind, count) {
  return count === 1 || kind === "other" ? kind : `${kind}s`;
}

/** Return the date and time of a recording in words. */
function dateText(date) {
  const day = date && new Date(date);
  if (!day || !Number.isFinite(day.getTime())) return "no date";
  return `${day.toLocaleString("en-GB", { dateStyle: "long", timeStyle: "short", timeZone: "UTC" })} UTC`;
}

let replay = null; // until the data are unpacked

Promise.all([unpack(GROUND), ...RECORDINGS.map(unpack)]).then(([ground, ...data]) => {
  replay = new Replay(data.map((each, index) => new Recorded(index, REPORTS[index], each)), ground, IMAGES);
  replay.stale = false;
  replay.start();
  replay.draw(performance.now());
  performance.mark("recap-first-frame");
}).catch((error) => {
  const sign = document.getElementById("nothing");
  sign.textContent = `This page cannot be shown: ${error.message}. A browser from 2023 or later was expected.`;
  sign.hidden = false;
  throw error;
});
