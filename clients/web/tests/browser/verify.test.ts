/** A swarm is executed again in the browser, and its hash is compared with the daemon's. */
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";
import type { Page, Route } from "playwright-core";
import { check } from "./axe.ts";
import { until } from "./browser.ts";
import { lacksEngine, readEngine } from "./engine.ts";
import { Site } from "./site.ts";

const site = new Site();
const skip = lacksEngine("verify.test.ts");
const EXPERIMENT = "**/demo/get/experiment";

/** The reply of `get/experiment`. */
interface Reply {
  result: { file: string; steps: number; state_hash: string };
}

/** Creates a swarm that has taken 5000 steps, with two commands. */
async function createDemo(): Promise<void> {
  if (!(await site.row("demo"))) {
    await site.daemon.create("demo", { n: 50, seed: 3 });
    await site.daemon.command("demo", "inform", { select: { count: 10 }, direction: 0.4 });
    await site.daemon.command("demo", "step", { steps: 2500 });
    await site.daemon.command("demo", "set", { pi3: 2 });
    await site.daemon.command("demo", "step", { steps: 2500 });
  }
}

async function openDemo(): Promise<Page> {
  await createDemo();
  return site.open("/swarm/demo", false);
}

const verify = (page: Page) => page.getByRole("button", { name: "Verify in your browser" });
const verdict = (page: Page) => page.locator(".verify [role=status]");

/** Lets the daemon's reply to `get/experiment` reach the page changed. */
async function change(page: Page, by: (result: Reply["result"]) => void): Promise<void> {
  await page.route(EXPERIMENT, async (route: Route) => {
    const reply = (await (await route.fetch()).json()) as Reply;
    by(reply.result);
    await route.fulfill({ json: reply });
  });
}

/** Clicks the button, and waits for an end. */
async function end(page: Page): Promise<string> {
  await verify(page).click();
  return until("a verdict", async () => {
    const text = await verdict(page).textContent();
    return /equal|different|not verified|cancelled/.test(text ?? "") && text;
  });
}

test("a swarm of 5000 steps is equal in under 10 s", { skip }, async () => {
  const page = await openDemo();
  const began = performance.now();
  const text = await end(page);
  assert(performance.now() - began < 10_000);
  const { result } = await site.daemon.get<Reply>("demo/get/experiment");
  assert.equal(text, `equal after 5,000 steps: ${result.state_hash.slice(0, 8)}…`);
  const codes = await page.locator(".verify code").allTextContents();
  const sha256 = createHash("sha256").update(readEngine()).digest("hex");
  assert.deepEqual(codes, [sha256, result.state_hash, result.state_hash]);
  await page.getByText("against a daemon that lies it proves nothing").waitFor();
  await check(page, "verified");
});

test("a swarm with an altered command is different", { skip }, async () => {
  const page = await openDemo();
  await change(page, (it) => {
    assert(it.file.includes("direction = 0.4,"));
    it.file = it.file.replace("direction = 0.4,", "direction = 0.41,");
  });
  assert.equal(await end(page), "different at the end: jostle verify demo names the step");
  const codes = await page.locator(".verify code").allTextContents();
  assert.notEqual(codes[1], codes[2]);
});

test("progress is shown, and a cancel ends it", { skip }, async () => {
  const page = await openDemo();
  await change(page, (it) => {
    it.file = it.file.replace(/^duration = .*$/m, "duration = 20000.0");
    it.steps = 1_000_000;
  });
  await verify(page).click();
  await page.getByText(/executing step \d[\d,]* of 1,000,000/).waitFor();
  await page.getByText(/\d (s|min) left/).waitFor();
  assert(await verify(page).isDisabled());
  const worker = page.workers()[0];
  assert(worker);
  const ended = new Promise((resolve) => worker.once("close", resolve));
  await page.getByRole("button", { name: "Cancel", exact: true }).click();
  await ended;
  assert.equal(await verdict(page).textContent(), "cancelled");
  assert(await verify(page).isEnabled());
});

test("a cancel while the commands are requested ends it", { skip }, async () => {
  const page = await openDemo();
  let answer = () => {};
  const mayAnswer = new Promise<void>((resolve) => {
    answer = resolve;
  });
  await page.route(EXPERIMENT, async (route) => {
    await mayAnswer;
    await route.continue();
  });
  const asked = page.waitForRequest(EXPERIMENT);
  await verify(page).click();
  await asked;
  await page.getByRole("button", { name: "Cancel", exact: true }).click();
  const answered = page.waitForResponse(EXPERIMENT);
  answer();
  await (await answered).finished();
  await page.waitForTimeout(500);
  assert.equal(await verdict(page).textContent(), "cancelled");
  assert.deepEqual(page.workers(), []);
});

test("leaving the page ends the worker", { skip }, async () => {
  const page = await openDemo();
  await change(page, (it) => {
    it.file = it.file.replace(/^duration = .*$/m, "duration = 20000.0");
    it.steps = 1_000_000;
  });
  await verify(page).click();
  const worker = await until("a worker", async () => page.workers()[0]);
  const ended = new Promise((resolve) => worker.once("close", resolve));
  await page.goto(`${site.daemon.addresses.http}/#/`);
  await ended;
});

test("commands at the present step are no part of a run, which is said", { skip }, async () => {
  await site.daemon.create("changed", { n: 10, seed: 1 });
  await site.daemon.command("changed", "step", { steps: 5 });
  await site.daemon.command("changed", "set", { pi3: 2 });
  const page = await site.open("/swarm/changed", false);
  assert.match(
    await end(page),
    /^not verified: commands at the present step 5 .*Step the swarm once/,
  );
  await site.daemon.command("changed", "step", { steps: 1 });
  assert.match(await end(page), /^equal after 6 steps: /);
});

test("without a secure context the hash of the engine is the daemon's", { skip }, async () => {
  await createDemo();
  const { page } = await site.openTab();
  await page.addInitScript("Object.defineProperty(crypto, 'subtle', { value: undefined })");
  await page.goto(`${site.daemon.addresses.http}/#/swarm/demo`);
  assert.match(await end(page), /^equal/);
  await page.getByText("(according to the daemon)").waitFor();
  const sha256 = createHash("sha256").update(readEngine()).digest("hex");
  assert.equal(await page.locator(".verify code").first().textContent(), sha256);
});

test("a fork is verified from a snapshot on, with the changes since", { skip }, async () => {
  await site.daemon.create("mother", { n: 20, seed: 1 });
  await site.daemon.command("mother", "step", { steps: 5 });
  await site.daemon.command("mother", "fork", { name: "fork" });
  const tab = await site.openTabAt("/swarm/fork", false);
  tab.expectsError(/^409 GET \/api\/get\/fork\/get\/experiment$/, 2);
  const { page } = tab;
  const paused = end(page);
  assert.match(await paused, /^not verified: the swarm takes no steps: run it/);
  await site.daemon.command("fork", "run", { rate: 2 });
  const running = end(page);
  await page.getByText("from a snapshot on, since").waitFor();
  await site.daemon.command("fork", "inform", { select: { count: 5 }, direction: 1 });
  await site.daemon.command("fork", "annotate", { text: "a note" });
  await site.daemon.command("fork", "batch", {
    commands: [
      { verb: "set", args: { pi3: 2 } },
      { verb: "inform", args: { select: { count: 3 }, direction: 2 } },
    ],
  });
  assert.match(await running, /^equal from step [\d,]+ to step [\d,]+: [0-9a-f]{8}…$/);
});

test("a fork that a controller steers is not verified from a snapshot on", { skip }, async () => {
  await site.daemon.create("steered", { n: 20, seed: 1 });
  await site.daemon.command("steered", "step", { steps: 5 });
  await site.daemon.command("steered", "fork", { name: "steered-fork" });
  await site.daemon.command("steered-fork", "run", { rate: 2 });
  const tab = await site.openTabAt("/swarm/steered-fork", false);
  tab.expectsError(/^409 GET \/api\/get\/steered-fork\/get\/experiment$/);
  // A controller needs a token of a zenoh session, which a page does not have.
  await tab.page.route("**/steered-fork/get/controllers", async (route: Route) => {
    const reply = (await (await route.fetch()).json()) as { result: { controllers: object[] } };
    reply.result.controllers.push({ controller: "ada" });
    await route.fulfill({ json: reply });
  });
  assert.equal(
    await end(tab.page),
    "not verified: the controller ada steers individuals, and events do not contain its set-points: " +
      "jostle verify replays them from the journal",
  );
});

test("a swarm that is faulted or gone is not verified, which is said", { skip }, async () => {
  await site.daemon.create("broken", { n: 5, seed: 1 });
  await site.daemon.command("broken", "step", { steps: 5 });
  const tab = await site.openTabAt("/swarm/broken", false);
  tab.expectsError(/^40[49] GET \/api\/get\/broken\/get\/experiment$/, 2);
  const { page } = tab;
  const reject = (status: number, code: string) =>
    page.route("**/broken/get/experiment", (route) =>
      route.fulfill({ status, json: { code, message: "rejected", details: {}, step: null } }),
    );
  await page.route("**/broken/get/status", async (route: Route) => {
    const reply = (await (await route.fetch()).json()) as { phase: string };
    await route.fulfill({ json: { ...reply, phase: "faulted" } });
  });
  await reject(409, "conflict");
  assert.match(await end(page), /^not verified: the swarm takes no steps: it is faulted/);
  await reject(404, "not_found");
  assert.equal(await end(page), "not verified: the daemon has this swarm no longer");
});

test("a release says whether the engine is its own", { skip }, async () => {
  const page = await openDemo();
  const sha256 = createHash("sha256").update(readEngine()).digest("hex");
  const digest = page.locator(".verify dt").first();
  for (const [released, said] of [
    [null, "SHA-256 of the engine"],
    [sha256, "SHA-256 of the engine (that of the release)"],
    ["3f2a", "SHA-256 of the engine (not that of the release, 3f2a)"],
  ] as const) {
    await page.route("**/jostle.wasm", async (route: Route) => {
      const response = await route.fetch();
      const headers = response.headers();
      const more = released === null ? {} : { "jostle-wasm-release-sha256": released };
      await route.fulfill({ response, headers: { ...headers, ...more } });
    });
    assert.match(await end(page), /^equal/);
    assert.equal(await digest.textContent(), said);
    await page.unroute("**/jostle.wasm");
  }
});

test("a swarm whose file would be too long is verified from a snapshot on", { skip }, async () => {
  await site.daemon.create("long", { n: 20, seed: 1 });
  await site.daemon.command("long", "run", { rate: 2 });
  const tab = await site.openTabAt("/swarm/long", false);
  tab.expectsError(/^429 GET \/api\/get\/long\/get\/experiment$/);
  const { page } = tab;
  const json = { code: "resource_exhausted", message: "it is too long", details: {}, step: null };
  await page.route("**/long/get/experiment", (route) => route.fulfill({ status: 429, json }));
  assert.match(await end(page), /^equal from step [\d,]+ to step [\d,]+: [0-9a-f]{8}…$/);
});

test("without a connection it asks for the engine again later", { skip }, async () => {
  const tab = await site.openTab();
  tab.expectsError(/ERR_CONNECTION_REFUSED \/jostle\.wasm$/);
  const { page } = tab;
  await page.route("**/jostle.wasm", (route) => route.abort("connectionrefused"));
  const failed = page.waitForEvent("requestfailed");
  await page.goto(`${site.daemon.addresses.http}/#/swarm/school`);
  await failed;
  await page.unroute("**/jostle.wasm");
  await page.goto(`${site.daemon.addresses.http}/#/`);
  assert(!(await verify(page).isVisible()));
  await page.goto(`${site.daemon.addresses.http}/#/swarm/school`);
  await verify(page).waitFor();
});

test("without an engine there is no button", async () => {
  const { page } = await site.openTab();
  await page.route("**/jostle.wasm", (route) => route.fulfill({ status: 404 }));
  await page.goto(`${site.daemon.addresses.http}/#/swarm/school`);
  await page.getByRole("button", { name: "Download as experiment" }).waitFor();
  await page.waitForLoadState("networkidle");
  assert(!(await verify(page).isVisible()));
});
