import assert from "node:assert/strict";
import { test } from "node:test";
import { DEFAULT_QUERY, formatQuery, parseQuery, selectRows } from "../src/pages/list_query.ts";
import { parseRoute } from "../src/ui/router.ts";
import type { SwarmSummary } from "../src/wire/messages.ts";

function row(swarm: string, other: Partial<SwarmSummary> = {}): SwarmSummary {
  return {
    swarm,
    phase: "running",
    reason: null,
    step: 0,
    time: 0,
    n: 10,
    informed: 0,
    order: 0,
    rate: 1,
    real_time_factor: 1,
    ...other,
  };
}

const ROWS = [
  row("fish-10", { n: 30, order: 0.2 }),
  row("fish-2", { n: 20, order: 0.9, phase: "paused", real_time_factor: null }),
  row("discs", { n: 20, order: 0.5, replay: true }),
  row("bad", { phase: "faulted", contested_by: "lab-2", real_time_factor: null }),
];

const names = (hash: string) => selectRows(ROWS, parseQuery(hash)).map((it) => it.swarm);

test("the filter takes parts of names and a kind of swarm", () => {
  assert.deepEqual(names("#/"), ["bad", "discs", "fish-2", "fish-10"]);
  assert.deepEqual(names("#/?q=FISH+0"), ["fish-10"]);
  assert.deepEqual(names("#/?q=fish&show=paused"), ["fish-2"]);
  assert.deepEqual(names("#/?show=running"), ["discs", "fish-10"]);
  assert.deepEqual(names("#/?show=faulted"), ["bad"]);
  assert.deepEqual(names("#/?show=playback"), ["discs"]);
  assert.deepEqual(names("#/?show=contested"), ["bad"]);
  assert.deepEqual(names("#/?q=nothing"), []);
});

test("rows are sorted by a value, and by name where it is equal", () => {
  assert.deepEqual(names("#/?sort=-name"), ["fish-10", "fish-2", "discs", "bad"]);
  assert.deepEqual(names("#/?sort=n"), ["bad", "discs", "fish-2", "fish-10"]);
  assert.deepEqual(names("#/?sort=-order"), ["fish-2", "discs", "fish-10", "bad"]);
  assert.deepEqual(names("#/?sort=-real-time+factor").slice(2), ["fish-2", "bad"]);
});

test("a query survives the URL, and unknown values are ignored", () => {
  const query = { text: "a b&token=c/d?", show: "paused", sort: "n", descending: true } as const;
  assert.deepEqual(parseQuery(formatQuery(query)), query);
  assert.equal(formatQuery(DEFAULT_QUERY), "#/");
  assert.deepEqual(parseQuery("#/"), DEFAULT_QUERY);
  assert.deepEqual(parseQuery("#/?show=toString&sort=-weight").show, "all");
  assert.deepEqual(parseQuery("#/?show=toString&sort=weight").sort, "name");
  assert.deepEqual(parseRoute(formatQuery(query)), { page: "list" });
  // The token is read from a fragment with "token=": a filter must not look like one.
  assert(!formatQuery(query).includes("token="));
});
