// What is known of a recording at a time.

import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";

import { Camera } from "../source/camera.js";
import { unpack } from "../source/data.js";
import { Recorded, pair } from "../source/recorded.js";
import { Tracks } from "../source/tracks.js";

const none = { actor: new Int32Array(0), time: new Float64Array(0), value: new Int32Array(0) };
const BOX = /** @type {[number, number, number, number]} */ ([0, 0, 2, 1]);
const LOOK = { type: "", role: "", label: "", hero: false, color: "#ffffff", paint: null, shape: "car", box: BOX };

/** Return an actor. @param {number} id @param {number} since @param {number | null} until @returns {Actor} */
const actor = (id, since, until = null, kind = "vehicle") => ({ id, since, until, kind, ...LOOK });

/** Return a recording of samples at 0 to 9 s: actor 7 drives 1 m/s and turns left beyond 180°, is gone from 4 s on, and another one
 * has its id from 6 s on and stands; 8 is a walker that falls at 2 s and gets up at 5 s. @returns {RecordingData} */
const data = () => ({
  times: Float64Array.from({ length: 10 }, (_, i) => i), spans: [[0, 9]],
  actors: [actor(7, 0, 4), actor(7, 6), actor(8, 0, null, "walker")],
  tracks: [[0, 1, 2], [0, 6, 0], [3, 9, 9], [0, 4, 5], [4, 1, 1]].map((column) => Int32Array.from(column)),
  x: Float64Array.of(0, 1, 2, 3, 50, 5), y: Float64Array.of(0, 0, 0, 0, 4, 5),
  yaw: Float64Array.of(8000, 8192, 8400, 8600, 0, 4096), speed: Float64Array.of(1, 1, -1, 1, 0, 0),
  measured: /** @type {Measured[]} */ (/** @type {unknown} */ ([{
    id: 7, leader: Int32Array.of(8, 8, -1, -1, -1, -1, -1, -1, -1, -1), gap: Float64Array.of(9, 8, -128, 6, 5, 4, 3, 2, 1, 0),
  }])),
  lights: none, lamps: { actor: Int32Array.of(0, 0), time: Float64Array.of(1, 3), value: Int32Array.of(8, 0) },
  marks: [[5, [[5, 1]]], [8, []]],
  lying: { actor: Int32Array.of(2, 2), time: Float64Array.of(2, 5), value: Int32Array.of(90, -1) },
});

/** @param {string} kind @param {number | null} start @param {Place} place @returns {Incident} */
const incident = (kind, start, place = [start ?? 0, 1]) => ({ kind, start, stop: null, actors: [7], types: ["a"], place, text: "", picture: null });

/** @param {Partial<Report>} report */
const recorded = (report = {}, index = 0) => new Recorded(index, /** @type {Report} */ ({ incidents: [], ...report }), data());

test("poses are between those of samples, and yaw does not jump at a full turn", () => {
  const { tracks } = recorded();
  const pose = { x: 0, y: 0, yaw: 0 };
  assert.ok(tracks.pose(0, 1.5, tracks.sampleAt(1.5), pose));
  assert.deepEqual([pose.x, Math.round((pose.yaw * 180) / Math.PI)], [1.5, 182]);
  assert.equal(tracks.pose(0, 4, tracks.sampleAt(4), pose), false);
  assert.deepEqual([tracks.pose(1, 5, 5, pose), tracks.pose(1, 8.5, 8, pose), pose.x], [false, true, 50]);
});

test("an id is that of the actor that has it at a time", () => {
  const { tracks } = recorded();
  assert.deepEqual([0, 3, 5.9, 6, 99].map((time) => tracks.indexOf(7, time)), [0, 0, 0, 1, 1]);
  assert.deepEqual([tracks.indexOf(7, -5), tracks.indexOf(1, 0), tracks.indexOf(null, 0), tracks.indexOf(undefined, 0)], [0, -1, -1, -1]);
});

test("a path has no jumps, and goes on where the actor stands", () => {
  const { tracks } = recorded();
  assert.deepEqual(tracks.path(0, 1, 2.5), [[1, 0, 2, 0]]);
  tracks.own[0].push(1); // from the last sample of its track on, it stands
  tracks.first[1] = 3;
  assert.deepEqual(tracks.path(0, 2, 4), [[2, 0, 3, 0, 50, 4]]);
  tracks.first[1] = 4; // a sample later, after a jump
  assert.deepEqual([tracks.path(0, 2, 4), tracks.path(0, 5, 6)], [[[2, 0, 3, 0], [50, 4]], [[50, 4]]]);
});

test("samples of one span belong together, however far apart they are", () => {
  const tracks = new Tracks({ ...data(), times: Float64Array.of(0, 5, 10, 10.1), spans: [[0, 10], [10.1, 10.1]] });
  assert.deepEqual([0, 1, 2, 3].map((sample) => tracks.continues(sample)), [true, true, false, false]);
});

test("lamps are lit, and walkers lie, from one change to the next", () => {
  const { tracks } = recorded();
  assert.deepEqual([0.9, 1, 2.9, 3].map((time) => tracks.lampsOf(0, time)), [0, 8, 8, 0]);
  assert.deepEqual([1.9, 2, 5].map((time) => tracks.lying(2, time)), [null, Math.PI / 2, null]);
  assert.deepEqual([4.9, 5, 8].map((time) => tracks.marksAt(time)), [[], [[5, 1]], []]);
  assert.deepEqual([-0.1, 0, 9, 9.1].map((time) => tracks.covers(time)), [false, true, true, false]);
});

test("what is unknown, or of an absent actor, is no number", () => {
  const { motion } = recorded();
  const series = motion.series(0);
  assert.deepEqual([...series.values.speed].slice(0, 5), [1, 1, NaN, 1, NaN]);
  assert.deepEqual([...series.values.gap].slice(0, 5), [9, 8, NaN, 6, NaN]);
  assert.deepEqual([...series.leader].slice(0, 3), [2, 2, -1]);
  assert.ok(series.values.brake.every(Number.isNaN) && series.isMeasured && !motion.series(2).isMeasured);
});

test("incidents are found by their time", () => {
  const incidents = [incident("collision", 5), incident("blocked", 1), incident("collision", 2, null), incident("speeding", null)];
  const one = recorded({ incidents });
  assert.deepEqual(one.incidentsIn(0, 4).map(({ start }) => start), [1, 2]);
  assert.deepEqual([one.has(incident("collision", 5.9)), one.has(incident("collision", 6.1)), one.has(incident("blocked", 5))], [true, false, false]);
});

test("the given pairs of two recordings are the same actors", () => {
  const [first, second] = [recorded({ differences: { over: true, text: "", since: null, pairs: [[7, 6, 7, 0], [8, 0, 8, 0], [9, 0, 9, 0]] } }), recorded({}, 1)];
  pair(first, second);
  assert.deepEqual([0, 1, 2].map((index) => first.twin(index)), [-1, 0, 2]);
  assert.deepEqual([0, 1, 2].map((index) => second.twin(index)), [1, -1, 2]);
});

test("a point of the screen is a place in the world, also in a turned view", () => {
  const camera = Object.assign(new Camera(), { x: 10, y: -4, scale: 5, up: 1.1, width: 300, height: 200 });
  const [left, top] = camera.toScreen(3, 8);
  assert.deepEqual(camera.toWorld(left, top).map((value) => value.toFixed(9)), ["3.000000000", "8.000000000"]);
  const before = camera.toWorld(40, 30);
  camera.zoom(2, 40, 30);
  assert.deepEqual(camera.toWorld(40, 30).map((value) => value.toFixed(9)), before.map((value) => value.toFixed(9)));
});

test("columns are unpacked", async () => {
  const head = Buffer.from(JSON.stringify({ a: { column: [0, 3, 2, 0.5, 1] }, b: "text" }));
  const size = Buffer.alloc(4);
  size.writeUInt32LE(head.length);
  const columns = Buffer.of(0x58, 1, 4, 2, 0, 0); // zigzag of 300, -1, 2 in planes
  const found = await unpack(deflateSync(Buffer.concat([size, head, columns])).toString("base64"));
  assert.deepEqual([[...found.a], found.b], [[150, 149.5, 150.5], "text"]);
});
