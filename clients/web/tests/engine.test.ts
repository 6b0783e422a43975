import assert from "node:assert/strict";
import { test } from "node:test";
import { type Advance, Engine, EngineError, type Requests } from "../src/engine/engine.ts";
import { execute, type Report, type RunTask, spacingOf } from "../src/engine/job.ts";
import { Runner } from "../src/engine/runner.ts";
import { ECHO, MOST } from "./echo.ts";

/** A request whose name is a field of the reply, as the module of the tests echoes it. */
const send = (engine: Engine, name: string, args: unknown) =>
  engine.request(name as keyof Requests, args as never) as unknown;

test("a request is UTF-8 JSON, and so is its reply", async () => {
  const engine = await Engine.of(ECHO);
  assert.deepEqual(send(engine, "ok", { name: "π3 ≥ 2" }), { name: "π3 ≥ 2" });
});

test("an error of the engine has its code, message and details", async () => {
  const engine = await Engine.of(ECHO);
  const error = { code: "invalid_argument", message: "no such key", details: { line: 3 } };
  assert.throws(
    () => send(engine, "error", error),
    (it) => it instanceof EngineError && it.code === error.code && it.details.line === 3,
  );
  // The engine is of use after it.
  assert.deepEqual(send(engine, "ok", {}), {});
});

test("after a trap the text of the panic is the error, and the engine is discarded", async () => {
  const engine = await Engine.of(ECHO);
  const long = "x".repeat(MOST);
  assert.throws(
    () => send(engine, "ok", long),
    (it) => it instanceof EngineError && it.code === "panic" && it.message.includes(long),
  );
  for (const use of [() => send(engine, "ok", {}), () => engine.columns()]) {
    assert.throws(use, /discarded/);
  }
});

test("columns are read although the memory grows in between", async () => {
  const engine = await Engine.of(ECHO);
  const { id, x, y, alpha, weight, direction } = engine.columns();
  const read = [x, y, alpha, weight, direction].map((it) => [...it]);
  assert.deepEqual(read, [[1], [2], [3], [4], [5]]);
  assert.deepEqual([...id], [7]);
});

const SPEC = { n: 2, dt: 0.1 };
const END = { state_hash: "ab", order: 0.5, drift: null, contacts: 3 };

/** An engine whose run takes `total` steps, each of `step_ms` of a clock. */
function engineOf(total: number, step_ms: number, n = 2) {
  let step = 0;
  const asked: number[] = [];
  const clock = { ms: 0 };
  const answer = (name: string, args: unknown): unknown => {
    if (name === "plan") {
      return { name: "e", runs: [{ name: "e #0", steps: total, n }] };
    }
    if (name === "spec") {
      return { spec: SPEC };
    }
    const isLast = step === total;
    if (name === "advance") {
      const { steps } = args as { steps: number };
      asked.push(steps);
      clock.ms += step_ms * Math.min(steps, total - step);
      step = Math.min(total, step + steps);
    }
    return { ...END, step, fault: null, finished: isLast } as Partial<Advance>;
  };
  const columns = () => ({
    id: Uint32Array.of(0, 1),
    x: Float64Array.of(step, 0),
    y: new Float64Array(2),
    alpha: new Float64Array(2),
    weight: new Float64Array(2),
    direction: new Float64Array(2),
  });
  return { engine: { request: answer as Engine["request"], columns }, asked, clock };
}

function reports(job: RunTask, total: number, step_ms: number, n = 2) {
  const { engine, asked, clock } = engineOf(total, step_ms, n);
  const found: Report[] = [];
  execute(
    engine,
    job,
    (it) => found.push(it),
    () => clock.ms,
  );
  return { found, asked };
}

const JOB = { kind: "run" as const, files: { toml: "" }, run: 0, spacing: null };

test("a run reports its length, its progress and its hash", () => {
  const { found, asked } = reports(JOB, 1000, 0.1);
  assert.deepEqual(found[0], { kind: "begun", step: 0, steps: 1000, spec: SPEC });
  assert.deepEqual(found.at(-1), { kind: "finished", step: 1000, state_hash: "ab", fault: null });
  // Slices grow to about 50 ms, and a progress follows about each of them.
  assert(asked.length < 15, `${asked}`);
  assert(Math.max(...asked) <= 512, `${asked}`);
  assert(found.length >= 4, `${found.length}`);
});

test("a slow step is reported after each slice", () => {
  const { found, asked } = reports(JOB, 5, 400);
  assert.deepEqual(asked, [1, 1, 1, 1, 1, 1]);
  const steps = found.flatMap((it) => (it.kind === "progress" ? [it.step] : []));
  assert.deepEqual(steps, [1, 2, 3, 4, 5, 5]);
});

test("frames begin with the start, are evenly spaced, and end with the last state", () => {
  const { found } = reports({ ...JOB, spacing: 0.4 }, 10, 1);
  const frames = found.flatMap((it) => (it.kind === "progress" ? it.frames : []));
  assert.deepEqual(
    frames.map((it) => [it.step, it.x[0]]),
    [
      [0, 0],
      [4, 4],
      [8, 8],
      [10, 10],
    ],
  );
});

test("the frames of a long run of many fit in the memory", () => {
  assert.equal(spacingOf(5, 5000, 50), 5);
  const spacing = spacingOf(5, 1e6, 1000);
  assert((1e6 / spacing) * 1000 * 44 <= 64e6, `${spacing}`);
  assert.equal(spacingOf(1, 10, 1e9), 10);
});

test("an experiment without that run is an error", () => {
  for (const [run, named] of [
    [{ run: 3 }, ""],
    [{ run: 0, name: "e #1" }, ' "e #1"'],
  ] as const) {
    const { found } = reports({ ...JOB, ...run }, 10, 1);
    const message = `the experiment has no run${named} with the number ${run.run + 1}`;
    assert.deepEqual(found, [{ kind: "failed", code: "not_found", message, details: {} }]);
  }
  assert.equal(reports({ ...JOB, name: "e #0" }, 10, 1).found.at(-1)?.kind, "finished");
});

/** A worker of which the test is the other side. */
class FakeWorker {
  onmessage: ((event: { data: Report }) => void) | null = null;
  onerror: (() => void) | null = null;
  posted: unknown[] = [];
  ended = false;
  postMessage(it: unknown): void {
    this.posted.push(it);
  }
  terminate(): void {
    this.ended = true;
  }
}

test("the remaining time is that at the rate so far, and nothing follows a cancel", () => {
  const worker = new FakeWorker();
  const clock = { ms: 0 };
  const seen: string[] = [];
  const events = {
    progress: () => seen.push("progress"),
    finished: () => seen.push("finished"),
    failed: () => seen.push("failed"),
  };
  const job = { ...JOB, module: new ArrayBuffer(0) };
  const runner = new Runner(worker as unknown as Worker, job, events, () => clock.ms);
  assert.deepEqual(worker.posted, [job]);
  const send = (data: Report) => worker.onmessage?.({ data });
  clock.ms = 5000;
  send({ kind: "begun", step: 0, steps: 100, spec: null });
  assert.equal(runner.remaining, null);
  clock.ms = 7000;
  send({ kind: "progress", step: 40, frames: [] });
  assert.equal(runner.share, 0.4);
  assert.equal(runner.remaining, 3);
  runner.end();
  assert(worker.ended);
  send({ kind: "finished", step: 100, state_hash: "ab", fault: null });
  assert.deepEqual(seen, ["progress", "progress"]);
});
