import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { changesBetween } from "../src/engine/changes.ts";
import { execute, type Report } from "../src/engine/job.ts";
import type { SwarmEvent } from "../src/wire/page.ts";
import { readSnapshot } from "../src/wire/snapshot.ts";

const FIXTURES = new URL("../../../../proto/fixtures/", import.meta.url);

test("a snapshot is read, and its bytes are those of the reply", () => {
  const reply = readFileSync(new URL("snapshot.reply.cbor", FIXTURES));
  const read = readSnapshot(reply);
  const { result } = JSON.parse(readFileSync(new URL("snapshot.reply.json", FIXTURES), "utf8")) as {
    result: Record<string, unknown>;
  };
  for (const name of ["epoch", "step", "seq", "annotations", "state_hash"] as const) {
    assert.equal(read[name], result[name], name);
  }
  // The result is the last entry of the reply.
  assert.deepEqual(Buffer.from(read.bytes), reply.subarray(reply.length - read.bytes.length));
  assert.equal(read.bytes[0]! >> 5, 5);
  assert.throws(() => readSnapshot(Uint8Array.of(0xa0)), /no snapshot/);
});

function command(step: number, seq: number, verb: string, args: unknown = {}): SwarmEvent {
  return { step, event: { kind: "command", seq, verb, args } } as unknown as SwarmEvent;
}

const SET = { verb: "set", args: { pi3: 2 } };
const INFORM = { verb: "inform", args: { direction: 1 } };

test("changes have their steps, and the numbers of their draws leave out annotations", () => {
  const events = [
    command(0, 7, "set", { pi3: 9 }),
    command(10, 8, "inform", INFORM.args),
    command(10, 9, "annotate", { text: "a note" }),
    { ...command(11, 0, ""), event: { kind: "phase" } },
    command(12, 10, "run"),
    command(20, 13, "batch", { commands: [SET, INFORM, SET] }),
    command(25, 14, "fired", { condition: "order > 0", commands: [INFORM] }),
    command(30, 15, "set", SET.args),
    command(31, 16, "set", { pi3: 8 }),
  ];
  const found = changesBetween({ seq: 7, annotations: 2 }, { seq: 15 }, events);
  assert.deepEqual(found, [
    { step: 10, seq: 6, change: INFORM },
    { step: 20, seq: 8, change: SET },
    { step: 20, seq: 9, change: INFORM },
    { step: 20, seq: 10, change: SET },
    { step: 25, seq: 11, change: INFORM },
    { step: 30, seq: 12, change: SET },
  ]);
});

test("events after which set-points are missing are an error", () => {
  const events = [command(1, 8, "join", { controller: "ada" }), command(2, 9, "set", SET.args)];
  assert.throws(
    () => changesBetween({ seq: 7, annotations: 0 }, { seq: 9 }, events),
    /a controller has joined, and events do not contain its set-points/,
  );
});

test("events that the daemon no longer has are an error", () => {
  const from = { seq: 7, annotations: 0 };
  assert.throws(
    () => changesBetween(from, { seq: 9 }, [command(1, 9, "set")]),
    /no longer has the event of command 8/,
  );
  assert.throws(
    () => changesBetween(from, { seq: 9 }, [command(1, 8, "set")]),
    /no longer has the events of commands 9 to 9/,
  );
  assert.throws(
    () => changesBetween(from, { seq: 8 }, [command(1, 8, "batch", { protocol: true })]),
    /experiment plays/,
  );
});

test("a replay applies each change before its step, and the last ones after all", () => {
  let step = 100;
  const done: unknown[] = [];
  const request = (name: string, args: Record<string, unknown>) => {
    if (name === "step") {
      step += Number(args.steps);
    } else if (name === "apply") {
      done.push([step, args.seq]);
    }
    return { step, state_hash: `${step}/${done.length}`, fault: null };
  };
  const found: Report[] = [];
  const change = SET;
  execute(
    { request: request as never, columns: () => assert.fail("no frames are wanted") },
    {
      kind: "replay",
      snapshot: "",
      until: 140,
      changes: [
        { step: 100, seq: 1, change },
        { step: 117, seq: 2, change },
        { step: 140, seq: 3, change },
      ],
    },
    (it) => found.push(it),
    () => 0,
  );
  assert.deepEqual(done, [
    [100, 1],
    [117, 2],
    [140, 3],
  ]);
  assert.deepEqual(found, [
    { kind: "begun", step: 100, steps: 40, spec: null },
    { kind: "finished", step: 140, state_hash: "140/3", fault: null },
  ]);
});
