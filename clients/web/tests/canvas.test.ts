import assert from "node:assert/strict";
import { test } from "node:test";
import { headingRange } from "../src/canvas/bodies.ts";
import { Camera, extentOf } from "../src/canvas/camera.ts";
import { Motion } from "../src/canvas/motion.ts";
import { roundLength } from "../src/canvas/overlays.ts";
import { MAX_TIME, Trails } from "../src/canvas/trails.ts";
import { bodyOf, halfLengthTime } from "../src/geometry/body.ts";
import { type State, shift } from "../src/wire/state.ts";

function camera(): Camera {
  const it = new Camera();
  it.width = 800;
  it.height = 600;
  it.scale = 20;
  return it;
}

function state(step: number, x: number[], origin: [number, number] = [0, 0], epoch = 1): State {
  const n = x.length;
  return {
    swarm: "s",
    epoch,
    step,
    time: 0.02 * step,
    phase: "running",
    origin,
    id: Uint32Array.from({ length: n }, (_, i) => i),
    x: Float64Array.from(x),
    y: new Float64Array(n),
    alpha: new Float64Array(n),
    weight: new Float64Array(n),
    direction: new Float64Array(n),
    order: {
      order: 0,
      mean_order: null,
      velocity: [0, 0],
      mean_velocity: null,
      direction: null,
      drift: null,
      mean_drift: null,
    },
    certificate: {
      contacts: 0,
      crossed: 0,
      degraded: 0,
      iterations: 0,
      residual: 0,
      worst_gap: null,
    },
  };
}

test("screen and plane coordinates are inverse to each other", () => {
  const it = camera();
  [it.x, it.y] = [3, -2];
  assert.deepEqual(it.toScreen(3, -2), [400, 300]);
  // The y axis of the plane points up.
  assert.deepEqual(it.toScreen(4, -1), [420, 280]);
  assert.deepEqual(it.toPlane(420, 280), [4, -1]);
});

test("zooming keeps the point under the pointer, unless the camera follows", () => {
  const it = camera();
  it.following = false;
  const before = it.toPlane(650, 100);
  it.zoomAt(650, 100, 1.7);
  const after = it.toPlane(650, 100);
  assert(Math.hypot(after[0] - before[0], after[1] - before[1]) < 1e-12);
  const follower = camera();
  follower.zoomAt(650, 100, 1.7);
  assert.deepEqual([follower.x, follower.y], [0, 0]);
  assert.equal(follower.following, true);
});

test("dragging stops following, and following returns to the centre of mass", () => {
  const it = camera();
  const extent = { x: 5, y: 6, half_width: 4, half_height: 4 };
  it.track(extent, true);
  assert.deepEqual([it.x, it.y], [5, 6]);
  it.pan(20, 20);
  it.track({ ...extent, x: 9 }, true);
  assert(it.x < 5 && it.y > 6, "the plane moves with the pointer");
  it.follow();
  it.track({ ...extent, x: 9 }, true);
  assert.deepEqual([it.x, it.y], [9, 6]);
});

test("the scale fits the group and ignores small changes", () => {
  const it = camera();
  const extent = { x: 0, y: 0, half_width: 10, half_height: 10 };
  it.track(extent, true);
  const fitted = it.scale;
  assert(fitted * 10 <= 300);
  it.track({ ...extent, half_width: 9, half_height: 9 }, true);
  assert.equal(it.scale, fitted);
  it.track({ ...extent, half_width: 30, half_height: 30 }, true);
  assert(it.scale * 30 <= 300);
});

test("the extent is centred on the centre of mass and ignores a stray body", () => {
  const x = Float64Array.from({ length: 40 }, (_, i) => (i % 2 ? 1 : -1));
  x[0] = 500;
  const extent = extentOf(x, new Float64Array(40), false);
  assert(Math.abs(extent.x - (500 + 1) / 40) < 1e-12);
  assert(extent.half_width < 20);
});

test("while following on request the camera keeps every body in the picture", () => {
  const x = Float64Array.from({ length: 40 }, (_, i) => (i % 2 ? 1 : -1));
  const y = new Float64Array(40);
  const it = camera();
  const isWhole = (far: number) => {
    const [left, top] = it.toScreen(far, 0);
    return left + it.scale <= it.width && top > 0 && top < it.height;
  };
  for (const far of [50, 500, 1e6, 1e9]) {
    x[0] = far;
    it.track(extentOf(x, y, it.whole), true);
    assert.equal(isWhole(far), false, "the picture's own scale lets one go");
  }
  it.follow();
  for (const far of [1e9, 30, 31, 80, 1e7]) {
    x[0] = far;
    // Though the scale is still changing, all bodies are in this picture.
    it.track(extentOf(x, y, it.whole), false);
    assert(isWhole(far), `at ${far}`);
  }
  it.zoomAt(400, 300, 2);
  assert.equal(it.whole, false, "zooming ends fitting");
  it.follow();
  it.pan(1, 0);
  assert.equal(it.whole, false, "panning ends fitting");
});

test("a changed origin shifts positions by exact multiples of its unit", () => {
  assert.deepEqual(shift([5, -3], [4, -3]), [1024, 0]);
  const far = 2 ** 40;
  assert.deepEqual(shift([far + 1, 0], [far, 1]), [1024, -1024]);
  const motion = new Motion();
  motion.accept(state(1, [511.9]), 0, false, 0.8);
  const by = motion.accept(state(2, [-512.05], [1, 0]), 50, false, 0.8);
  assert.deepEqual(by, [-1024, 0]);
  // Halfway between 511.9 - 1024 = -512.1 and -512.05, across the change of origin.
  const shown = motion.at(50 + 45).x[0]!;
  assert(shown >= -512.1 - 1e-9 && shown <= -512.05, String(shown));
});

test("positions are interpolated between two states and end exactly", () => {
  const motion = new Motion();
  motion.accept(state(1, [0, 1]), 1000, false, 0.8);
  assert.equal(motion.isMoving(), false);
  motion.accept(state(6, [1, 3]), 1100, false, 0.8);
  assert.equal(motion.isMoving(), true);
  const half = motion.at(1150);
  assert(Math.abs(half.x[0]! - 0.5) < 1e-9 && Math.abs(half.x[1]! - 2) < 1e-9);
  assert.deepEqual([...motion.at(1300).x], [1, 3]);
  assert.equal(motion.isMoving(), false);
});

test("a changed group, an earlier step or another epoch is shown without interpolation", () => {
  for (const next of [state(6, [1, 3, 5]), state(0, [9, 9]), state(9, [1, 3], [0, 0], 2)]) {
    const motion = new Motion();
    motion.accept(state(5, [0, 1]), 1000, false, 0.8);
    motion.accept(next, 1050, false, 0.8);
    assert.deepEqual([...motion.at(1051).x], [...next.x]);
  }
});

test("states half a body length of free motion apart, or more, are not interpolated", () => {
  // Elongated bodies of 4 widths reach 0.8 body sizes from their centre, discs 0.5.
  assert.equal(halfLengthTime(bodyOf(4)), 0.8);
  assert.equal(halfLengthTime(bodyOf(1)), 0.5);
  for (const [steps, moves] of [
    [39, true],
    [40, false],
    [1250, false],
  ] as const) {
    const motion = new Motion();
    motion.accept(state(0, [0, 1]), 1000, false, 0.8);
    motion.accept(state(steps, [1, 3]), 1020, false, 0.8);
    assert.equal(motion.isMoving(), moves, `${steps} steps`);
    assert.deepEqual([...motion.at(1021).x].join() === "1,3", !moves, `${steps} steps`);
  }
});

test("interpolation never starts further back than the limit", () => {
  const motion = new Motion();
  motion.accept(state(0, [0]), 1000, false, 0.8);
  motion.accept(state(30, [0.6]), 1200, false, 0.8);
  // The first interpolation has hardly begun: from there it would span 1.2 time units.
  motion.accept(state(60, [1.2]), 1201, false, 0.8);
  assert.equal(motion.isMoving(), true);
  assert(motion.at(1202).x[0]! >= 0.6, "it begins at the state before");
});

test("the scale bar has a round length", () => {
  assert.equal(roundLength(24, 60), 5);
  assert.equal(roundLength(60, 60), 1);
  assert.equal(roundLength(300, 60), 0.2);
  assert.equal(roundLength(0.5, 60), 200);
});

test("equal ranges of headings are about 0, a quarter turn, and so on", () => {
  const quarter = Math.PI / 2;
  const ranges = [0, 0.7, -0.7, quarter, -quarter, 2 * quarter, -2 * quarter, 9 * quarter - 0.7];
  assert.deepEqual(
    ranges.map((it) => headingRange(it, 4)),
    [0, 0, 0, 1, 3, 2, 2, 1],
  );
});

test("trails keep positions at even intervals, up to their longest time", () => {
  const trails = new Trails();
  assert.equal(trails.time, Number.NEGATIVE_INFINITY);
  for (let step = 0; step <= 2000; step += 3) {
    trails.keep(state(step, [step]));
  }
  // Steps of 0.06 time units: every fourth is kept.
  assert(Math.abs(trails.time - 39.84) < 1e-9, `${trails.time}`);
  assert.equal(MAX_TIME, 15);
});
