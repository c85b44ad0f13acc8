// The clock and the part of the time that is shown.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Clock, clockTime, merged } from "../source/clock.js";
import { countUntil } from "../source/data.js";
import { Part } from "../source/part.js";

const clock = () => new Clock([[0, 2], [5, 6], [6, 6], [9, 12]], [0, 1, 2, 5, 6, 9, 10, 11, 12]);

test("a time that is not covered leads to the next one that is", () => {
  const found = [-1, 0, 2, 2.5, 5.5, 6, 7, 12, 40].map((time) => clock().nearest(time));
  assert.deepEqual(found, [0, 0, 2, 5, 5.5, 6, 9, 12, 12]);
});

test("steps go from sample to sample, to the ends, and pause", () => {
  const each = clock();
  each.play();
  const times = [1, 1, 1, 1, -1, -1, -20, 20].map((count) => {
    each.step(count);
    return each.time;
  });
  assert.deepEqual(times, [1, 2, 5, 6, 5, 2, 0, 12]);
  assert.equal(each.playing, false);
  each.seek(1.5);
  each.step(-1);
  assert.equal(each.time, 1);
  each.seek(1.5);
  each.step(1);
  assert.equal(each.time, 2);
  new Clock([], []).step(1);
});

test("playing skips what is not covered, and ends at the goal or the end", () => {
  const each = clock();
  each.setPace(0.1);
  each.playThrough(1.5, 5.5);
  each.tick(4);
  assert.equal(each.time, 1.9);
  each.tick(2);
  assert.deepEqual([each.time, each.jumps, each.playing], [5, 2, true]);
  each.tick(20);
  assert.deepEqual([each.time, each.playing], [5.5, false]);
  each.play();
  each.setPace(16);
  each.tick(1);
  assert.deepEqual([each.time, each.playing], [12, false]);
});

test("intervals of several recordings are joined", () => {
  assert.deepEqual(merged([[[0, 1], [4, 5]], [[0.5, 2], [2, 3], [4.2, 4.4]]]), [[0, 3], [4, 5]]);
  assert.deepEqual(merged([[], []]), []);
});

test("times are written as minutes and seconds", () => {
  assert.deepEqual([0, 59.96, 61.25, 3723.4].map((time) => clockTime(time)), ["0:00.0", "1:00.0", "1:01.3", "1:02:03.4"]);
  assert.deepEqual([clockTime(9.996, 2), clockTime(59.6, 0)], ["0:10.00", "1:00"]);
});

test("the part keeps the time under the pointer, and stays within the recording", () => {
  const part = new Part(60);
  part.zoom(4, 15);
  assert.deepEqual([part.start, part.stop, part.share(15)], [11.25, 26.25, 0.25]);
  part.move(-2);
  assert.deepEqual([part.start, part.stop, part.isWhole], [0, 15, false]);
  part.zoom(1e9, 7);
  assert.deepEqual([part.stop - part.start, part.share(7)].map((value) => value.toFixed(6)), ["0.500000", (7 / 15).toFixed(6)]);
  part.zoom(1e-9, 7);
  assert.deepEqual([part.start, part.stop, part.isWhole], [0, 60, true]);
  assert.deepEqual([-1, 0.5, 2].map((share) => part.timeAt(share)), [0, 30, 60]);
});

test("the part follows the time, seldom while it plays, and is still where the time is in it", () => {
  const part = new Part(100);
  part.set(20, 10);
  let changes = 0;
  part.addEventListener("change", () => changes++);
  for (let time = 20; time <= 95; time += 0.05) {
    part.show(time, true);
    assert.ok(part.share(time) >= 0 && part.share(time) <= 1, `${time} is in ${part.start} to ${part.stop}`);
  }
  assert.ok(changes < 12, `${changes} changes`);
  part.set(20, 10);
  part.show(29.9, false);
  assert.deepEqual([part.start, part.stop], [20, 30]);
  part.show(50, false);
  assert.deepEqual([part.start, part.stop], [45, 55]);
});

test("the part may be elsewhere while the time stands still", () => {
  const part = new Part(60);
  part.show(0, false);
  part.zoom(4, 48);
  part.show(0, false);
  assert.deepEqual([part.start, part.stop], [36, 51]);
  part.show(1, false);
  assert.ok(part.start <= 1);
});

test("a recording of no length has a part", () => {
  const part = new Part(0);
  part.zoom(2, 0);
  part.show(0, true);
  assert.ok(part.stop > part.start && part.isWhole);
});

test("the number of values up to one is that of a search one by one", () => {
  const values = [0, 1, 1, 1, 2.5, 7];
  for (const value of [-1, 0, 0.5, 1, 2, 2.5, 6.9, 7, 8, Infinity]) {
    assert.equal(countUntil(values, value), values.filter((each) => each <= value).length);
  }
  assert.equal(countUntil([], 1), 0);
});
