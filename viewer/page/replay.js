// The page: its parts, and what connects them.
"use strict";

const LEAD = 2; // s before an incident
const CLOSE_VIEW = 70; // m, the width of the view

class Replay {
  constructor(report, recording, ground) {
    this.report = report;
    this.tracks = new Tracks(recording);
    this.clock = new Clock(this.tracks.spans);
    this.camera = new Camera();
    this.stage = new Stage(document.getElementById("canvas"), this.tracks, this.camera, report, ground);
    this.incidents = new Incidents(report, this.tracks, (index) => this.open(index));
    this.transport = new Transport(this.clock, report, (index) => this.open(index));
    this.space = new Space(report, () => this.changed());
    this.jumps = -1;
    this.last = 0; // ms
    this.stale = true;
    this.linked = "";
    new Pointing(this.stage, {
      pick: (actor) => this.follow(this.tracks.actors[actor].id),
      view: () => this.changed(),
    });
    this.summarise();
    this.listen();
  }

  summarise() {
    const { map, source, date, version, frames, duration, kinds, program } = this.report;
    const day = date && new Date(date);
    const text = day && Number.isFinite(day.getTime()) ? dateText(day) : "no date";
    document.title = `${map || "Recording"} · ${source}`;
    document.getElementById("map").textContent = map || "No map name";
    document.getElementById("origin").textContent = `${source} · ${text}`;
    const facts = document.getElementById("facts");
    const add = (name, ...values) => {
      facts.append(element("div", "", "", [element("dt", "", name), element("dd", "", "", values)]));
    };
    add("Duration", duration === null ? "unknown" : clockTime(duration));
    add("Frames", frames.toLocaleString("en"));
    add("CARLA format", String(version));
    const shown = kinds.map(([kind, count, color]) => {
      const swatch = element("i", "swatch");
      swatch.style.background = color;
      return element("span", "kind", "", [swatch, element("b", "", String(count)), ` ${plural(kind, count)}`]);
    });
    add("Actors", ...(shown.length ? shown : ["none"]));
    document.getElementById("program").textContent = program;
  }

  listen() {
    const on = (id, action) => document.getElementById(id).addEventListener("click", action);
    on("fit", () => this.fit());
    on("closer", () => this.zoom(1.5));
    on("farther", () => this.zoom(1 / 1.5));
    on("heading", () => this.toggle("heading"));
    on("labels", () => this.toggle("labels"));
    on("trails", () => this.toggle("trails"));
    on("keys", () => document.getElementById("help").showModal());
    on("release", () => this.follow(null));
    on("previous", () => this.step(-1));
    on("next", () => this.step(1));
    this.clock.addEventListener("seek", () => this.changed());
    this.clock.addEventListener("state", () => this.changed());
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => this.readLink());
    new ResizeObserver(() => {
      this.stage.resize();
      this.stage.draw(this.clock.time); // resizing clears the canvas, which is painted before the next frame
      this.changed();
    }).observe(this.stage.canvas);
  }

  /** Show the beginning, or the time and actor in the address. */
  start() {
    this.stage.resize();
    this.follow(this.report.follow, { quiet: true });
    this.camera.show(CLOSE_VIEW * 1.5);
    if (this.pose() === null) {
      this.stage.draw(this.clock.time);
      this.fit();
    }
    this.begun = this.link(); // is left out of the address
    this.readLink();
    this.changed();
  }

  // --- actions ------------------------------------------------------------------------------------------

  /** Go to shortly before an incident, and follow the first of its actors. */
  open(index) {
    const incident = this.report.incidents[index];
    if (!incident || !this.incidents.items[index].replayed) return;
    this.incidents.choose(index);
    this.clock.seek(Math.max(0, incident.start - LEAD));
    const present = incident.actors.find((id) => this.poseOf(id) !== null);
    this.follow(present ?? null, { quiet: true });
    if (present === undefined && incident.place[0] !== null && incident.place[1] !== null) {
      [this.camera.x, this.camera.y] = incident.place;
    }
    this.camera.show(CLOSE_VIEW);
    const { length } = this.report.incidents;
    this.say(`Incident ${index + 1} of ${length}: ${incident.text}`);
  }

  step(direction) {
    const index = this.incidents.neighbour(direction);
    if (index >= 0) this.open(index);
  }

  follow(id, { quiet = false } = {}) {
    this.camera.followed = id;
    if (!quiet) this.say(id === null ? "No actor is followed" : `Following ${this.actor(id)?.label ?? id}`);
    this.changed();
  }

  fit() {
    this.camera.fit(this.stage.bounds);
    this.changed();
  }

  zoom(factor) {
    this.camera.zoom(factor);
    this.changed();
  }

  toggle(what) {
    if (what === "heading") this.camera.turns = !this.camera.turns;
    else this.stage[what] = !this.stage[what];
    const pressed = what === "heading" ? this.camera.turns : this.stage[what];
    document.getElementById(what).setAttribute("aria-pressed", String(pressed));
    this.changed();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || document.getElementById("help").open) return;
    const { target } = event;
    const onCanvas = target === this.stage.canvas;
    if (target.matches("select")) return;
    const seconds = event.shiftKey ? 0.1 : 1;
    const pan = (right, down) => () => (this.camera.pan(right, down), this.changed());
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
      l: () => this.toggle("labels"),
      t: () => this.toggle("trails"),
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

  actor(id) {
    return this.tracks.actors[this.tracks.indexOf(id, this.clock.time)] ?? null;
  }

  poseOf(id) {
    const [pose, index] = [{}, this.tracks.indexOf(id, this.clock.time)];
    const { time } = this.clock;
    return index >= 0 && this.tracks.pose(index, time, this.tracks.sampleAt(time), pose) ? pose : null;
  }

  pose() {
    return this.camera.followed === null ? null : this.poseOf(this.camera.followed);
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
    const turning = this.camera.step(this.pose(), seconds, jumped);
    if (this.space.isOpen) this.space.show(this.clock.time, this.actor(this.camera.followed));
    else this.stage.draw(this.clock.time);
    this.transport.showTime();
    this.showFollowed();
    this.showCaption();
    this.showRule();
    this.writeLink();
    if (this.clock.playing || turning) this.changed();
  }

  showFollowed() {
    const { followed } = this.camera;
    const actor = followed === null ? null : this.actor(followed);
    document.getElementById("followed").hidden = !actor;
    document.getElementById("heading").disabled = !actor;
    if (!actor) return;
    const index = this.tracks.indexOf(followed, this.clock.time);
    const set = (id, text) => {
      const node = document.getElementById(id);
      if (node.textContent !== text) node.textContent = text;
    };
    document.getElementById("followed-color").style.background = actor.color;
    set("followed-name", actor.label);
    set("followed-type", [actor.type || actor.kind, actor.role && actor.role !== "hero" ? actor.role : ""].filter(Boolean).join(" · "));
    set("speed", (this.tracks.speed(index, this.clock.time) * 3.6).toFixed(0));
  }

  /** Show the text of the incident around the present time. */
  showCaption() {
    const { time } = this.clock;
    const { incidents } = this.report;
    const near = incidents.findLastIndex(({ start }) => start !== null && start - 0.05 <= time && time <= start + LEAD);
    const caption = document.getElementById("caption");
    caption.hidden = near < 0;
    if (near >= 0 && caption.textContent !== incidents[near].text) {
      caption.textContent = incidents[near].text;
      caption.dataset.kind = incidents[near].kind;
    }
  }

  showRule() {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((m) => m * this.camera.scale >= 56) ?? 1e4;
    document.getElementById("rule").style.width = `${metres * this.camera.scale}px`;
    document.getElementById("rule-length").textContent = metres < 1000 ? `${metres} m` : `${metres / 1000} km`;
  }

  say(text) {
    document.getElementById("status").textContent = text;
  }

  // --- the time and the followed actor in the address ---------------------------------------------------

  readLink() {
    if (location.hash === this.linked) return;
    const words = new URLSearchParams(location.hash.slice(1));
    const number = (name) => (words.get(name) && Number.isFinite(Number(words.get(name))) ? Number(words.get(name)) : null);
    const incident = number("incident");
    if (incident !== null) this.open(incident - 1);
    if (number("t") !== null) this.clock.seek(Math.max(0, number("t")));
    const id = number("follow");
    if (id !== null && this.tracks.byId.has(id)) this.follow(id, { quiet: true });
    if (number("t") !== null && incident === null) this.incidents.choose(-1);
    this.linked = location.hash;
  }

  link() {
    const { followed } = this.camera;
    return `#t=${Number(this.clock.time.toFixed(2))}${followed === null ? "" : `&follow=${followed}`}`;
  }

  writeLink() {
    const link = this.link();
    if (this.clock.playing || link === this.linked || (link === this.begun && !this.linked)) return;
    this.linked = link;
    clearTimeout(this.linking);
    this.linking = setTimeout(() => history.replaceState(null, "", link), 250);
  }
}

function plural(kind, count) {
  return count === 1 || kind === "other" ? kind : `${kind}s`;
}

function dateText(day) {
  return `${day.toLocaleString("en-GB", { dateStyle: "long", timeStyle: "short", timeZone: "UTC" })} UTC`;
}

const replay = new Replay(REPORT, RECORDING, GROUND);
replay.stale = false;
replay.start();
replay.draw(performance.now());
performance.mark("recap-first-frame");
