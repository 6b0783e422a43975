import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { describe } from "../src/panels/events.ts";
import {
  History,
  isolated,
  MAX_POINTS,
  momentOfOrder,
  momentOfState,
  SERIES,
} from "../src/panels/history.ts";
import { directionOf } from "../src/panels/numbers.ts";
import { rangeOf } from "../src/panels/ranges.ts";
import { brief, degrees, fixed, rates, short, signed, ticks } from "../src/ui/format.ts";
import { parseRoute } from "../src/ui/router.ts";
import { linkCommand } from "../src/ui/session.ts";
import { command, get, RequestError } from "../src/wire/http.ts";
import type { OrderSample, Parameter, Reply } from "../src/wire/messages.ts";
import type { Hello, SwarmEvent } from "../src/wire/page.ts";
import { decodeState } from "../src/wire/state.ts";

const FIXTURES = new URL("../../../../proto/fixtures/", import.meta.url);
const bytes = (name: string) => readFileSync(new URL(name, FIXTURES));
const json = <T>(name: string) => JSON.parse(bytes(name).toString()) as T;

test("a state in CBOR equals the one in JSON, bit for bit", () => {
  const state = decodeState(bytes("state.cbor"));
  const shown = json<Record<string, unknown>>("state.json");
  const plain = Object.entries(state).map(([name, it]) => [
    name,
    ArrayBuffer.isView(it) ? Array.from(it as Float64Array) : it,
  ]);
  assert.deepEqual(Object.fromEntries(plain), shown);
  assert(state.x instanceof Float64Array && state.id instanceof Uint32Array);
});

test("an invalid state is rejected", () => {
  assert.throws(() => decodeState(bytes("state.cbor").subarray(0, 40)));
});

test("every kind of event has a text", () => {
  const text = (name: string) => describe(json<SwarmEvent>(`event.${name}.json`));
  assert.equal(text("command"), "set pi3 1 · by ada@lab");
  assert.equal(text("phase"), "paused: requested");
  assert.equal(text("fault"), "fault: a defect: the step panicked");
  assert.equal(text("lapsed"), "inform expired, uninformed: 0, 2");
  assert.match(text("scheduled"), /^run rate 2 scheduled for step 551/);
  assert.match(text("refused"), /^run rejected: the swarm was reset before step 551/);
  assert.equal(text("created"), "created · by ada@lab");
  assert.equal(text("deleted"), "deleted · by ada@lab");
  assert.equal(text("model"), "model version 2 goes on, after version 1");
  const forked = json<SwarmEvent>("event.created.json");
  Object.assign(forked.event, { verb: "fork", client: null });
  assert.equal(describe(forked), "created (fork)");
  // As earlier versions send it.
  forked.event = { kind: "created" };
  assert.equal(describe(forked), "created");
  const informed = json<SwarmEvent>("event.command.json");
  informed.event.verb = "inform";
  informed.event.args = { direction: 1.5708, select: { foremost: { count: 3, along: -0.5 } } };
  const said = "inform direction 90.0°, select foremost count 3, along −28.6° · by ada@lab";
  assert.equal(describe(informed), said);
  const noted = json<SwarmEvent>("event.command.json");
  noted.event.verb = "annotate";
  noted.event.args = json<object>("annotate.args.json");
  assert.equal(describe(noted), "note: camera 2 replaced · by ada@lab");
  const kept = json<SwarmEvent>("event.command.json");
  kept.event.verb = "protect";
  kept.event.args = json<object>("protect.args.json");
  assert.equal(describe(kept), "protected from delete and reset · by ada@lab");
  kept.event.args = { on: false };
  assert.equal(describe(kept), "no longer protected · by ada@lab");
});

test("every parameter has a range as text", () => {
  const reply = json<Reply<{ parameters: Parameter[] }>>("parameters.reply.json");
  const range = Object.fromEntries(reply.result.parameters.map((it) => [it.name, rangeOf(it)]));
  assert.equal(range.pi1, "from 1 to 32");
  assert.equal(range.dt, "above 0 to 0.25 body size / free speed");
  assert.equal(range.contacts, "endpoints, closest, clamped");
  assert.equal(range.attraction, "all, voronoi, metric, topological, power");
  assert.equal(range.rate, "above 0 to 1000000 time units / s, or none");
});

test("the history is bounded, and drops points when time goes back", () => {
  const message = momentOfOrder(json<OrderSample>("order.json"));
  const history = new History(SERIES);
  for (let k = 0; k < MAX_POINTS + 50; k += 1) {
    history.add({ ...message, time: k }, 1000 * k);
  }
  assert.equal(history.time.length, MAX_POINTS);
  assert.equal(history.columns.drift.length, MAX_POINTS);
  assert.equal(history.time[0], 50);
  history.add({ ...message, time: 100, epoch: message.epoch + 1 }, 1e9);
  assert.equal(history.time.at(-1), 100);
  assert.equal(history.time.length, 51);
});

test("of points in quick succession the newest is kept", () => {
  const message = momentOfOrder(json<OrderSample>("order.json"));
  const history = new History(SERIES);
  const times = [1, 1.1, 1.2, 1.3, 1.4];
  times.forEach((time, k) => {
    history.add({ ...message, time, order: k }, 40 * k);
  });
  assert.deepEqual(history.time, [1.2, 1.4]);
  assert.deepEqual(history.columns.order, [2, 4]);
});

test("a change while paused replaces the last point", () => {
  const message = momentOfOrder(json<OrderSample>("order.json"));
  const history = new History(SERIES);
  history.add({ ...message, time: 1, drift: null }, 0);
  history.add({ ...message, time: 2, drift: null }, 5000);
  history.add({ ...message, time: 2, drift: -0.246 }, 5010);
  assert.deepEqual(history.time, [1, 2]);
  assert.deepEqual(history.columns.drift, [null, -0.246]);
  history.add({ ...message, time: 2, drift: null }, 99_000);
  assert.deepEqual(history.columns.drift, [null, null]);
});

test("a state and the order of the same frame give the same moment", () => {
  const state = decodeState(bytes("state.cbor"));
  const moment = momentOfState(state, null);
  assert.equal(moment.informed, [...state.weight].filter((it) => it > 0).length);
  assert.equal(moment.n, state.id.length);
  assert.equal(moment.drift, state.order.drift);
  const message = json<OrderSample>("order.json");
  assert.deepEqual(Object.keys(momentOfOrder(message)).sort(), Object.keys(moment).sort());
});

test("the direction of the informed is shown, and its strength if they disagree", () => {
  const newest = momentOfOrder(json<OrderSample>("order.json"));
  const shown = (direction: number | null, direction_strength: number | null) =>
    directionOf({ ...newest, direction, direction_strength });
  assert.equal(shown(1.5708, 1), "90.0°");
  assert.equal(shown(-1.5708, null), "−90.0°");
  assert.equal(shown(0.5, 0.996), "28.6°");
  assert.equal(shown(0.5, 0.714), "28.6°, strength 0.71");
  assert.equal(shown(null, 0.02), "none, strength 0.02");
  assert.equal(shown(null, null), "–");
});

test("values without neighbours are found", () => {
  assert.deepEqual(isolated([0.5]), [0]);
  assert.deepEqual(isolated([null, 0.5]), [1]);
  assert.deepEqual(isolated([0.1, 0.2, null, 0.3, null]), [3]);
  assert.deepEqual(isolated([]), []);
});

test("the command that prints the link quotes its path, and uses sudo where only root can read it", () => {
  const hello = { node: "lab", token_file: "/var/lib/jostle/jostle/lab/page-token" } as Hello;
  const origin = "http://127.0.0.1:8080";
  assert.equal(
    linkCommand(origin, { ...hello, token_needs_root: true }),
    'echo "http://127.0.0.1:8080/#token=$(sudo cat /var/lib/jostle/jostle/lab/page-token)"',
  );
  // For a path that needs quoting the command is executed.
  const folder = mkdtempSync(join(tmpdir(), "a \"b's $(exit 3) `exit 4` "));
  try {
    const token_file = join(folder, "page-token");
    writeFileSync(token_file, "c0ffee\n");
    const command = linkCommand(origin, { ...hello, token_needs_root: false, token_file });
    assert.equal(execFileSync("sh", ["-c", command]).toString(), `${origin}/#token=c0ffee\n`);
  } finally {
    rmSync(folder, { recursive: true });
  }
  assert.equal(
    linkCommand(origin, { ...hello, token_file: null }),
    `jostle --credentials FOLDER auth link --page ${origin}`,
  );
});

test("URL fragments select pages", () => {
  assert.deepEqual(parseRoute(""), { page: "list" });
  assert.deepEqual(parseRoute("#/swarm/school"), { page: "swarm", name: "school" });
  assert.deepEqual(parseRoute("#/gallery"), { page: "gallery", name: null });
  assert.deepEqual(parseRoute("#/gallery/a-1"), { page: "gallery", name: "a-1" });
  assert.deepEqual(parseRoute("#/nowhere"), { page: "list" });
});

test("numbers are formatted", () => {
  assert.equal(fixed(-0.0001, 2), "0.00");
  assert.equal(fixed(-0.5, 1), "−0.5");
  assert.equal(fixed(null, 1), "–");
  assert.equal(signed(0.25, 2), "+0.25");
  assert.equal(short({ kind: "metric", radius: 3 }), "metric, radius 3");
  assert.equal(short(9007199254740991), "9007199254740991");
  assert.equal(degrees(Math.PI), 180);
  assert.equal(degrees(-Math.PI / 2), -90);
});

test("one picture per second is singular", () => {
  assert.equal(rates(1.2, 0.9), "1 picture, 1 state a second");
  assert.equal(rates(0.6, 0), "1 picture, 0 states a second");
  assert.equal(rates(59.7, 1.6), "60 pictures, 2 states a second");
});

test("a brief number has four digits, and a small one a power of ten", () => {
  const numbers = [0, 13, 0.0123456, 1234.56, -0.25, -1.234e-8, 0.00099, Number.NaN, null];
  const texts = ["0", "13", "0.01235", "1235", "−0.25", "−1.2e-8", "9.9e-4", "–", "–"];
  assert.deepEqual(numbers.map(brief), texts);
});

test("a request is sent again while the daemon recovers its swarms, a command under its id", async () => {
  const busy = (reason: string) => ({
    code: "busy",
    message: "try again",
    details: { reason, swarms_left: 2 },
    step: null,
  });
  const replies: [number, object][] = [];
  const received: string[] = [];
  const server = createServer((request, response) => {
    let body = "";
    request.on("data", (chunk) => {
      body += chunk;
    });
    request.on("end", () => {
      received.push(body);
      const [status, reply] = replies.shift() ?? [200, { result: {} }];
      response.writeHead(status, { "Content-Type": "application/json", Connection: "close" });
      response.end(JSON.stringify(reply));
    });
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address() as AddressInfo;
  // The page names paths only.
  const { fetch } = globalThis;
  globalThis.fetch = (path, init) => fetch(`http://127.0.0.1:${port}${path}`, init);
  try {
    replies.push([429, busy("recovering")], [429, busy("handover")]);
    await command("school", "step", { steps: 3 });
    assert.equal(received.length, 3);
    assert.equal(new Set(received).size, 1, "the same request");
    replies.push([429, busy("recovering")]);
    await get("school", "status");
    assert.equal(received.length, 5);
    replies.push([429, { ...busy(""), details: {} }]);
    await assert.rejects(get("school", "status"), RequestError);
    assert.equal(received.length, 6, "an overloaded daemon is spared");
  } finally {
    globalThis.fetch = fetch;
    server.close();
  }
});

test("the labels of an axis are exact, however narrow it is", () => {
  for (const [values, labels] of [
    [[3.2625, 3.265, 3.2675], "3.2625 3.265 3.2675"],
    [[3.6915, 3.692, 3.6925], "3.6915 3.692 3.6925"],
    [[12345, 12346, 12347], "12345 12346 12347"],
    [[-0.2, -0.1, 0, 0.1 + 0.2], "−0.2 −0.1 0 0.3"],
    [[0, 10, 20], "0 10 20"],
    [[0, 2e-4, 4e-4], "0 2.0e-4 4.0e-4"],
    [[7], "7"],
  ] as const) {
    assert.equal(ticks([...values]).join(" "), labels);
  }
});
