import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { gzipSync } from "node:zlib";
import { isEqual } from "../src/player/claim.ts";
import { licencesOf, parseContent, unpack } from "../src/player/file.ts";
import { decodeFrames, orderOf } from "../src/player/frames.ts";
import { Timeline } from "../src/player/timeline.ts";
import { mayVary, valueIn, withValue } from "../src/player/variant.ts";
import { encodeFrames, type Poses, storeFrames } from "./frames.ts";

const POSES: Poses[] = [
  {
    step: 0,
    id: [0, 1, 7],
    informed: [false, true, false],
    x: [0, -5, 400],
    y: [1, 2, 3],
    alpha: [0, 512, -90000],
  },
  {
    step: 5,
    id: [0, 1, 7],
    informed: [false, true, false],
    x: [2, -9, 130],
    y: [1, 2, 3],
    alpha: [9, 512, 70],
  },
  // One is removed, one is added, and the informed change.
  {
    step: 10,
    id: [1, 7, 8],
    informed: [true, true, false],
    x: [-9, 0, 5e6],
    y: [2, 9, -5e9],
    alpha: [1, 2, 3],
  },
  // After a reset.
  {
    step: 2,
    id: [1, 7, 8],
    informed: [true, true, false],
    x: [1, 2, 3],
    y: [2, 9, 4],
    alpha: [1, 2, 3],
  },
];

test("frames are decoded by their ids and predictions", () => {
  const stored = storeFrames(POSES, [
    [0, 4],
    [2, 3],
  ]);
  const frames = decodeFrames(encodeFrames(POSES), stored);
  assert.equal(frames.length, POSES.length);
  frames.forEach((frame, k) => {
    const poses = POSES[k]!;
    assert.equal(frame.step, poses.step);
    assert.deepEqual([...frame.id], poses.id);
    assert.deepEqual([...frame.weight], poses.informed.map(Number));
    assert.deepEqual(
      [...frame.x],
      poses.x.map((it) => it * 0.01),
    );
    assert.deepEqual(
      [...frame.y],
      poses.y.map((it) => it * 0.01),
    );
    assert.deepEqual(
      [...frame.alpha],
      poses.alpha.map((it) => it * ((2 * Math.PI) / 1024)),
    );
  });
  assert.deepEqual(
    frames.map((it) => it.pi1),
    [4, 4, 3, 3],
  );
});

test("bytes as the format describes them", () => {
  // Two frames of one individual, id 3, informed: x is 1 and -1, y 300 and 300, alpha 0 and 64.
  const bytes = Uint8Array.of(0, 2, 6, 1, 2, 0xd8, 4, 0, 10, 0, 3, 0, 0x80, 1);
  const stored = { count: 2, quantum: 0.5, turn: 256, pi1: [[0, 2]] as [number, number][] };
  const [first, second] = decodeFrames(bytes, stored);
  assert.deepEqual([first!.step, first!.id[0], first!.weight[0]], [0, 3, 1]);
  assert.deepEqual([first!.x[0], first!.y[0], first!.alpha[0]], [0.5, 150, 0]);
  assert.deepEqual([second!.step, second!.x[0], second!.y[0]], [5, -0.5, 150]);
  assert.equal(second!.alpha[0], Math.PI / 2);
  assert.throws(() => decodeFrames(bytes.subarray(0, 12), stored), /damaged at byte 12/);
});

test("compressed data are unpacked", async () => {
  const stored = storeFrames(POSES, [[0, 4]]);
  assert.deepEqual(new Uint8Array(await unpack(stored.data)), encodeFrames(POSES));
});

test("licences are a text or packed", async () => {
  const licences = gzipSync("MIT …").toString("base64");
  assert.equal(await licencesOf({ licences }), "MIT …");
  assert.equal(await licencesOf({ licences: "MIT …" }), "MIT …");
  assert.equal(await licencesOf({ licences: "" }), "");
});

test("the order is the length of the mean heading", () => {
  assert.equal(orderOf(Float64Array.of(1, 1, 1)), 1);
  assert(orderOf(Float64Array.of(0, Math.PI)) < 1e-15);
  assert.equal(orderOf(new Float64Array()), 0);
});

test("a later format and an empty document are rejected", () => {
  assert.throws(
    () => parseContent('{"format": 2, "version": "9.0.0"}'),
    /made by a later version \(9\.0\.0\)/,
  );
  assert.throws(() => parseContent("{{jostle:file}}"), /jostle export/);
});

test("a timeline finds frames by time, also after a reset", () => {
  const timeline = new Timeline(0.02, 1);
  assert.equal(timeline.at(0), -1);
  timeline.add(decodeFrames(encodeFrames(POSES), storeFrames(POSES, [[0, 4]])));
  assert.deepEqual(
    timeline.times.map((it) => it.toFixed(2)),
    ["0.00", "0.10", "0.20", "0.24"],
  );
  assert.deepEqual(
    [0, 0.05, 0.1, 0.15, 9].map((it) => timeline.at(it)),
    [0, 0, 1, 1, 3],
  );
});

test("two frames of one step are a step apart", () => {
  const timeline = new Timeline(0.02, 1);
  const frames = decodeFrames(encodeFrames(POSES), storeFrames(POSES, [[0, 4]]));
  timeline.add([frames[1]!, frames[1]!]);
  assert.deepEqual(
    timeline.times.map((it) => it.toFixed(2)),
    ["0.10", "0.12"],
  );
  assert.equal(timeline.start, timeline.times[0]);
});

test("equal are step, hash and fault", () => {
  const claim = { steps: 10, state_hash: "ab" };
  const end = { step: 10, state_hash: "ab", fault: null };
  assert(isEqual(claim, end));
  assert(!isEqual(claim, { ...end, state_hash: "ac" }));
  assert(!isEqual(claim, { ...end, step: 9 }));
  assert(!isEqual(claim, { ...end, fault: "bodies cross" }));
  assert(isEqual({ ...claim, fault: "bodies cross" }, { ...end, fault: "bodies cross" }));
});

const EXPORT = `# The commands of the swarm school up to step 600, t = 12.
name = "school"
seeds = [3]
duration = 12.0

[spec]
dt = 0.02
n = 50    # at the start
pi3 = 1_0.5

[[at]]
step = 0    # t = 0
inform = { direction = 0.4, select = { count = 10 } }

[[at]]
step = 500
set = { pi3 = 2.0 }
`;

test("the values of a file are read, and changed where they are", () => {
  const read = (["seed", "duration", "n", "pi3", "pi1"] as const).map((it) => valueIn(EXPORT, it));
  assert.deepEqual(read, [3, 12, 50, 10.5, null]);
  const changed = withValue(withValue(EXPORT, "pi3", 3), "seed", 8);
  const lines = EXPORT.split("\n");
  const differ = changed.split("\n").filter((it, k) => it !== lines[k]);
  assert.deepEqual(differ, ["seeds = [8]", "pi3 = 3.0"]);
  assert.match(withValue(EXPORT, "n", 20), /^n = 20$/m);
  assert.match(withValue(EXPORT, "duration", 5e-7), /^duration = 5e-7$/m);
});

test("a value that a file does not state is put into its table", () => {
  assert.match(withValue(EXPORT, "pi1", 2), /^\[spec\]\npi1 = 2\.0\ndt = 0\.02$/m);
  const plain = 'name = "plain"\nseeds = [1]\n';
  assert.equal(withValue(plain, "pi1", 2.5), `${plain}\n\n[spec]\npi1 = 2.5\n`);
});

test("what a snapshot determines is not offered", () => {
  const offered = (["n", "pi1", "pi3"] as const).map((it) =>
    mayVary({ toml: EXPORT, start: "a snapshot" }, it),
  );
  assert.deepEqual(offered, [false, false, true]);
});

test("what a grid or points vary is not offered", () => {
  assert(mayVary({ toml: EXPORT }, "pi3"));
  assert(!mayVary({ toml: `${EXPORT}\n[[grid]]\npi3 = [1, 2]\n` }, "pi3"));
  assert(!mayVary({ toml: EXPORT, points: "pi3,pi4\n1,2\n" }, "pi4"));
  assert(mayVary({ toml: EXPORT }, "seed"));
  assert(!mayVary({ toml: "replicates = 3\n" }, "seed"));
  assert(!mayVary({ toml: "seeds = [1, 2]\n" }, "seed"));
});

test("the player is one file that requests nothing", () => {
  const path = join(import.meta.dirname, "../../dist-player/player.html");
  const html = readFileSync(path, "utf8");
  for (const place of ["title", "file", "module"]) {
    assert.equal(html.split(`{{jostle:${place}}}`).length, 2, place);
  }
  assert(
    html.includes('<script type="application/json" id="jostle-file">{{jostle:file}}</script>'),
  );
  assert(html.trimEnd().endsWith("</html>"));
  assert.doesNotMatch(html, /<(?:script|link|img)[^>]*\s(?:src|href)=/);
  const policy = /http-equiv="Content-Security-Policy" content="([^"]*)"/.exec(html)?.[1] ?? "";
  assert.match(policy, /^default-src 'none';/);
  assert.doesNotMatch(policy, /connect-src|unsafe-inline|unsafe-eval'.*'unsafe-eval|https?:/);
  assert(html.length < 200_000, `${html.length} bytes`);
});
