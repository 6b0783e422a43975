import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { describe } from "../src/panels/events.ts";
import { History, MOST_POINTS } from "../src/panels/history.ts";
import { rangeOf } from "../src/panels/ranges.ts";
import { degrees, fixed, short, signed } from "../src/parts/format.ts";
import { parseRoute } from "../src/parts/router.ts";
import type { OrderMessage, Parameter, Reply, SwarmEvent } from "../src/wire/messages.ts";
import { decodeState } from "../src/wire/state.ts";

const FIXTURES = new URL("../../../../proto/fixtures/", import.meta.url);
const bytes = (name: string) => readFileSync(new URL(name, FIXTURES));
const json = <T>(name: string) => JSON.parse(bytes(name).toString()) as T;

test("a state in CBOR is the one that its JSON shows, to the bit", () => {
  const state = decodeState(bytes("state.cbor"));
  const shown = json<Record<string, unknown>>("state.json");
  const plain = Object.entries(state).map(([name, it]) => [
    name,
    ArrayBuffer.isView(it) ? Array.from(it as Float64Array) : it,
  ]);
  assert.deepEqual(Object.fromEntries(plain), shown);
  assert(state.x instanceof Float64Array && state.id instanceof Uint32Array);
});

test("what is no state is refused", () => {
  assert.throws(() => decodeState(bytes("state.cbor").subarray(0, 40)));
});

test("every kind of event has words", () => {
  const told = (name: string) => describe(json<SwarmEvent>(`event.${name}.json`));
  assert.equal(told("command"), "set pi3 1 · by ada@lab");
  assert.equal(told("phase"), "paused: requested");
  assert.equal(told("fault"), "fault: a defect: the step panicked");
  assert.equal(told("lapsed"), "uninformed, their time being over: 0, 2");
  assert.match(told("scheduled"), /^run rate 2 is to apply at step 551/);
  assert.match(told("refused"), /^run refused: the swarm was reset before step 551/);
  assert.match(told("created"), /^created/);
});

test("every parameter has its range in words", () => {
  const reply = json<Reply<{ parameters: Parameter[] }>>("parameters.reply.json");
  const range = Object.fromEntries(reply.result.parameters.map((it) => [it.name, rangeOf(it)]));
  assert.equal(range.pi1, "from 1 to 32");
  assert.equal(range.dt, "above 0 to 0.25 body size / free speed");
  assert.equal(range.contacts, "endpoints, closest, clamped");
  assert.equal(range.attraction, "all, voronoi, metric, topological, power");
  assert.equal(range.rate, "above 0 to 1000000 time units / s, or none");
});

test("the history is bounded, and goes back when time does", () => {
  const message = json<OrderMessage>("order.json");
  const history = new History();
  for (let k = 0; k < MOST_POINTS + 50; k += 1) {
    history.add({ ...message, time: k }, 1000 * k);
  }
  assert.equal(history.time.length, MOST_POINTS);
  assert.equal(history.columns.drift.length, MOST_POINTS);
  assert.equal(history.time[0], 50);
  history.add({ ...message, time: 100, epoch: message.epoch + 1 }, 1e9);
  assert.equal(history.time.at(-1), 100);
  assert.equal(history.time.length, 51);
});

test("points that come too fast, or say the same, are left out", () => {
  const message = json<OrderMessage>("order.json");
  const history = new History();
  assert.equal(history.add({ ...message, time: 1 }, 0), true);
  assert.equal(history.add({ ...message, time: 1.1 }, 20), false);
  assert.equal(history.add({ ...message, time: 1.2 }, 140), true);
  assert.equal(history.add({ ...message, time: 1.2 }, 900), false);
});

test("addresses lead to pages", () => {
  assert.deepEqual(parseRoute(""), { page: "list" });
  assert.deepEqual(parseRoute("#/swarm/school"), { page: "swarm", name: "school" });
  assert.deepEqual(parseRoute("#/gallery"), { page: "gallery", name: null });
  assert.deepEqual(parseRoute("#/gallery/a-1"), { page: "gallery", name: "a-1" });
  assert.deepEqual(parseRoute("#/nowhere"), { page: "list" });
});

test("numbers read well", () => {
  assert.equal(fixed(-0.0001, 2), "0.00");
  assert.equal(fixed(-0.5, 1), "−0.5");
  assert.equal(fixed(null, 1), "–");
  assert.equal(signed(0.25, 2), "+0.25");
  assert.equal(short({ kind: "metric", radius: 3 }), "metric, radius 3");
  assert.equal(short(9007199254740991), "9007199254740991");
  assert.equal(degrees(Math.PI), 180);
  assert.equal(degrees(-Math.PI / 2), -90);
});
