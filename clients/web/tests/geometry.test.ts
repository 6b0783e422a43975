import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { type Body, bodyOf, gap, meetingPoint } from "../src/geometry/body.ts";
import { enclosed, encloses, nearest } from "../src/geometry/lasso.ts";
import { preferences } from "../src/geometry/preference.ts";
import {
  type Bodies,
  clusterNumbers,
  findClusters,
  findTouching,
  TOUCHING,
  touchingShare,
} from "../src/geometry/touching.ts";

const close = (a: number, b: number, within = 1e-12) =>
  assert(Math.abs(a - b) <= within, `${a} is not ${b}`);

/** A seeded random generator (mulberry32). */
function draws(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let it = Math.imul(state ^ (state >>> 15), 1 | state);
    it = (it + Math.imul(it ^ (it >>> 7), 61 | it)) ^ it;
    return ((it ^ (it >>> 14)) >>> 0) / 2 ** 32;
  };
}

function someBodies(n: number, side: number, seed: number): Bodies {
  const draw = draws(seed);
  const column = (scale: number) => Float64Array.from({ length: n }, () => scale * draw());
  return { x: column(side), y: column(side), alpha: column(2 * Math.PI) };
}

test("a body's length over width is pi1, and their mean is 1", () => {
  for (const pi1 of [1, 1.5, 4, 8, 32]) {
    const { half_length, radius } = bodyOf(pi1);
    const length = 2 * (half_length + radius);
    close(length / (2 * radius), pi1, 1e-12 * pi1);
    close((length + 2 * radius) / 2, 1);
  }
});

test("bodies end to end touch at their caps, and side by side along them", () => {
  const body = bodyOf(4);
  close(gap(2 * (body.half_length + body.radius), 0, 0, 0, body), 0);
  close(gap(0, 2 * body.radius, 0, Math.PI, body), 0);
  close(gap(0, 2 * body.radius, 0, 0, body), 0);
});

test("a head against a side touches where the cap meets it", () => {
  const body = bodyOf(4);
  const far = body.half_length + 2 * body.radius;
  close(gap(0, -far, 0, Math.PI / 2, body), 0);
  const [x, y] = meetingPoint(0, -far, 0, Math.PI / 2, body);
  close(x, 0);
  close(y, -body.radius);
});

test("bodies side by side meet in the middle of their common length", () => {
  const body = bodyOf(4);
  const [x, y] = meetingPoint(0.4, 2 * body.radius, 0, 0, body);
  close(x, 0.2);
  close(y, body.radius);
});

test("crossing axes are the deepest overlap, and discs measure their centres", () => {
  const body = bodyOf(4);
  close(gap(0.1, 0, 0, Math.PI / 2, body), -2 * body.radius);
  close(gap(0.6, 0.8, 1, 2, bodyOf(1)), 0);
});

test("a gap is symmetric in the two bodies", () => {
  const draw = draws(3);
  const body = bodyOf(4);
  for (let k = 0; k < 200; k += 1) {
    const [dx, dy, a, b] = [2 * draw() - 1, 2 * draw() - 1, 7 * draw(), 7 * draw()];
    close(gap(dx, dy, a, b, body), gap(-dx, -dy, b, a, body), 1e-9);
  }
});

test("the grid finds the same pairs as trying all pairs", () => {
  for (const pi1 of [1, 4, 8]) {
    const body = bodyOf(pi1);
    const bodies = someBodies(120, 9, pi1);
    const pairs = findTouching(bodies, body);
    const found = new Set<string>();
    for (let k = 0; k < pairs.length; k += 2) {
      found.add(`${pairs[k]} ${pairs[k + 1]}`);
    }
    assert.deepEqual(found, tryAll(bodies, body));
    assert(found.size > 10);
  }
});

function tryAll({ x, y, alpha }: Bodies, body: Body): Set<string> {
  const found = new Set<string>();
  for (let i = 0; i < x.length; i += 1) {
    for (let j = i + 1; j < x.length; j += 1) {
      if (gap(x[j]! - x[i]!, y[j]! - y[i]!, alpha[i]!, alpha[j]!, body) < TOUCHING) {
        found.add(`${i} ${j}`);
      }
    }
  }
  return found;
}

test("clusters are connected components, and isolated bodies are in none", () => {
  const pairs = Uint32Array.from([0, 1, 4, 5, 1, 2, 5, 6, 6, 7]);
  assert.deepEqual(findClusters(9, pairs), [
    [4, 5, 6, 7],
    [0, 1, 2],
  ]);
  assert.deepEqual(findClusters(3, new Uint32Array()), []);
  close(touchingShare(9, pairs), 7 / 9);
  close(touchingShare(0, new Uint32Array()), 0);
});

test("a lasso encloses by the even-odd rule, also one with a dent", () => {
  const dented = [0, 0, 4, 0, 4, 4, 2, 1, 0, 4];
  assert(encloses(dented, 0.5, 2));
  assert(encloses(dented, 3.5, 2));
  assert(!encloses(dented, 2, 2));
  assert(!encloses(dented, 5, 2));
  const x = Float64Array.from([0.5, 2, 3.5, -1]);
  const y = Float64Array.from([2, 2, 2, 0]);
  const bodies = { x, y, alpha: new Float64Array(4) };
  assert.deepEqual(enclosed(dented, bodies), [0, 2]);
  assert.deepEqual(enclosed([0, 0, 4, 4], bodies), []);
});

test("a click selects the nearest body, and none when it is far from all", () => {
  const body = bodyOf(4);
  const bodies = {
    x: Float64Array.from([0, 1]),
    y: Float64Array.from([0, 1]),
    alpha: Float64Array.from([0, Math.PI / 2]),
  };
  assert.equal(nearest(bodies, body, 0.7, 0.05, 0), 0);
  assert.equal(nearest(bodies, body, 1.1, 1.5, 0), 1);
  assert.equal(nearest(bodies, body, 0.3, 0.6, 0), null);
  assert.equal(nearest(bodies, body, 0.3, 0.6, 0.5), 0);
});

test("attractions cancel, and an informed individual adds its weight", () => {
  const bodies = someBodies(20, 5, 7);
  const none = preferences(bodies, new Float64Array(20), new Float64Array(20));
  let [x, y] = [0, 0];
  for (let i = 0; i < 20; i += 1) {
    x += none[2 * i]!;
    y += none[2 * i + 1]!;
  }
  close(x, 0);
  close(y, 0);
  const weight = new Float64Array(20);
  const direction = new Float64Array(20);
  [weight[3], direction[3]] = [0.5, Math.PI / 2];
  const one = preferences(bodies, weight, direction);
  close(one[7]! - none[7]!, 0.5);
  close(one[6]! - none[6]!, 0);
});

/** States with the values of crates/measures, whose test `fixture` writes the file. */
interface Measured {
  pi1: number;
  x: number[];
  y: number[];
  alpha: number[];
  measures: Record<string, number | null>;
}

test("clusters are those of the daemon's measures", () => {
  const file = new URL("../../../../crates/measures/tests/states.json", import.meta.url);
  const groups = JSON.parse(readFileSync(file).toString()) as Measured[];
  assert(groups.length > 4);
  for (const { pi1, x, y, alpha, measures } of groups) {
    const bodies = {
      x: Float64Array.from(x),
      y: Float64Array.from(y),
      alpha: Float64Array.from(alpha),
    };
    const pairs = findTouching(bodies, bodyOf(pi1));
    const numbers = clusterNumbers(x.length, findClusters(x.length, pairs));
    const {
      "clusters.count": count,
      "clusters.largest": largest,
      "clusters.n_eff": n_eff,
    } = measures;
    assert.deepEqual(numbers, { count, largest, n_eff });
  }
});

test("a single individual is a cluster, and an empty group has none", () => {
  assert.deepEqual(clusterNumbers(4, [[0, 2]]), { count: 3, largest: 2, n_eff: 1.5 });
  assert.deepEqual(clusterNumbers(2, []), { count: 2, largest: 1, n_eff: 1 });
  assert.equal(clusterNumbers(0, []), null);
});
