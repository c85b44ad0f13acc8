// The pictures of incidents in the list: drawn when they are about to be seen, in the colours of the theme.

import { Camera } from "./camera.js";
import { element } from "./elements.js";
import { Stage } from "./stage.js";
import { theme } from "./theme.js";

const PICTURE = [480, 300]; // px
const NARROWEST = 36; // m from left to right, at least
const WIDEST = 400; // m, at most
const PATH_TIME = 5; // s before and after an incident

export class Pictures {
  /** @param {import("./ground").Ground} ground */
  constructor(ground) {
    this.ground = ground;
    /** @type {Map<Element, { recording: Recorded, incident: Incident, large: boolean, drawn: string | null }>} */
    this.entries = new Map();
    this.stages = /** @type {Map<Recorded, Stage>} */ (new Map());
    this.observer = new IntersectionObserver((seen) => this.see(seen), { rootMargin: "300px" });
    theme.addEventListener("change", () => this.redraw());
  }

  /** Return an image of an incident, which is drawn later. @param {Recorded} recording @param {Incident} incident */
  image(recording, incident) {
    const image = element("img", "picture");
    Object.assign(image, { alt: "", width: PICTURE[0], height: PICTURE[1] });
    if (incident.picture) {
      Object.assign(image, { src: incident.picture, loading: "lazy", decoding: "async" });
      return image;
    }
    this.entries.set(image, { recording, incident, large: false, drawn: null });
    this.observer.observe(image);
    return image;
  }

  /** @param {IntersectionObserverEntry[]} seen */
  see(seen) {
    for (const { target, isIntersecting } of seen) if (isIntersecting) this.fill(target);
  }

  redraw() {
    for (const [image, entry] of this.entries) {
      if (entry.drawn || theme.printing) this.fill(image);
    }
  }

  /** @param {Element} image */
  fill(image) {
    const entry = this.entries.get(image);
    const drawn = `${theme.name} ${entry?.large}`;
    if (!entry || entry.drawn === drawn) return;
    entry.drawn = drawn;
    /** @type {HTMLImageElement} */ (image).src = this.draw(entry.recording, entry.incident, entry.large);
  }

  /** Draw a picture for more or less room: the names of actors are in large ones alone. @param {Element | null} image @param {boolean} large */
  enlarge(image, large) {
    const entry = image && this.entries.get(image);
    if (!entry) return;
    entry.large = large;
    if (entry.drawn) this.fill(image);
  }

  /** Return the address of a picture. @param {Recorded} recording @param {Incident} incident @param {boolean} large */
  draw(recording, { kind, start: begin, actors: ids, place }, large) {
    const start = begin ?? 0;
    const stage = this.stage(recording);
    const { tracks } = recording;
    const actors = ids.map((id) => tracks.indexOf(id, start)).filter((actor) => actor >= 0);
    const points = ids.flatMap((id) => recording.poseOf(id, start) ?? []).map(({ x, y }) => [x, y]);
    if (place) points.push(place);
    if (!points.length) points.push([0, 0]);
    const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
    const { camera } = stage;
    [camera.x, camera.y] = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
    const across = Math.max(Math.max(...xs) - Math.min(...xs), ((Math.max(...ys) - Math.min(...ys)) * PICTURE[0]) / PICTURE[1]);
    camera.scale = PICTURE[0] / Math.min(WIDEST, Math.max(large ? NARROWEST : NARROWEST * 0.6, 1.6 * across));
    stage.draw(start);
    stage.drawPaths(actors, start - PATH_TIME, start, start + PATH_TIME);
    for (const one of stage.shown) if (actors.includes(one.actor)) stage.drawActor(one);
    if (kind === "collision" && place) stage.drawCross(...camera.toScreen(...place), 1);
    const taken = /** @type {number[][]} */ ([]);
    for (const { actor, left, top } of large ? stage.shown : []) {
      if (actors.includes(actor)) stage.label(actor, left, top, taken, true);
    }
    return stage.canvas.toDataURL("image/webp", 0.85);
  }

  /** @param {Recorded} recording */
  stage(recording) {
    const known = this.stages.get(recording);
    if (known) return known;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = PICTURE;
    const camera = new Camera();
    [camera.width, camera.height] = PICTURE;
    const stage = new Stage(canvas, [recording], camera, this.ground);
    Object.assign(stage, { labels: false, trails: false, marks: false });
    this.stages.set(recording, stage);
    return stage;
  }
}
