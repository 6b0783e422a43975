/** The files of `jostle export` play from a disk, without network. */
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, rmSync, truncateSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, test } from "node:test";
import type { BrowserContextOptions, Page } from "playwright-core";
import type { Content } from "../../src/player/file.ts";
import { type Poses, storeFrames } from "../frames.ts";
import { check } from "./axe.ts";
import { tabsOfEachTest, until } from "./browser.ts";
import { lacksEngine, readEngine } from "./engine.ts";
import { BASE, exportRun, writePlayer } from "./player.ts";

const openTab = tabsOfEachTest();
const folder = mkdtempSync(join(tmpdir(), "jostle-player-"));
after(() => rmSync(folder, { recursive: true }));
const skip = lacksEngine("player.test.ts");

/** Forty frames of two that move to the right, five steps apart. */
const POSES: Poses[] = Array.from({ length: 40 }, (_, k) => ({
  step: 5 * k,
  id: [0, 1],
  informed: [false, true],
  x: [10 * k, 10 * k],
  y: [0, 200],
  alpha: [0, 0],
}));
const RECORDING: Content = {
  ...BASE,
  kind: "recording",
  name: "recording",
  frames: storeFrames(POSES, [[0, 4]]),
};

/** Opens a file; fails if it requests anything but itself and its worker. */
async function open(
  content: Content,
  module: Uint8Array | null,
  options?: BrowserContextOptions,
): Promise<Page> {
  const address = writePlayer(folder, content, module);
  const { page } = await openTab(options);
  page.on("request", (request) => {
    const url = request.url();
    assert(url === address || url.startsWith("blob:"), `requests ${url}`);
  });
  await page.goto(address);
  return page;
}

const verdict = (page: Page) => page.locator(".claim [role=status]");
const slider = (page: Page) => page.getByRole("slider", { name: "time" });
/** The part of the time that is played. */
const position = async (page: Page) => Number(await slider(page).inputValue()) / 1000;

test("a recording plays, pauses and seeks by keys", async () => {
  const page = await open(RECORDING, null);
  assert.equal(await verdict(page).textContent(), "a recording");
  assert.equal(await page.title(), "recording");
  await until("it plays", async () => (await position(page)) > 0.1);
  await page.keyboard.press(" ");
  const paused = await position(page);
  await page.getByRole("button", { name: "Play" }).waitFor();
  await page.waitForTimeout(200);
  assert.equal(await position(page), paused);
  await slider(page).press("End");
  assert.equal(await slider(page).getAttribute("aria-valuetext"), "t 3.90 · step 195");
  await slider(page).press("Home");
  assert.equal(await slider(page).getAttribute("aria-valuetext"), "t 0.00 · step 0");
  await page.getByText("2 individuals · 1 informed").waitFor();
  // At the end it begins again.
  await slider(page).press("End");
  await page.getByRole("button", { name: "Play" }).click();
  await until("it plays again", async () => {
    const now = await position(page);
    return now > 0 && now < 0.8;
  });
});

test("with reduced motion nothing plays by itself", async () => {
  const page = await open(RECORDING, null, { reducedMotion: "reduce" });
  await page.getByRole("button", { name: "Play" }).waitFor();
  await page.waitForTimeout(300);
  assert.equal(await position(page), 0);
});

test("a file of a later version says so", async () => {
  const page = await open({ ...RECORDING, format: 2, version: "9.1.0" }, null);
  await page.getByRole("alert").getByText("made by a later version (9.1.0)").waitFor();
});

test("a run without engine plays its frames, and names the command that verifies it", async () => {
  const claim = { steps: 195, state_hash: "ab".repeat(32) };
  const content: Content = { ...RECORDING, kind: "run", files: { toml: "" }, claim };
  const page = await open(content, null);
  assert.match(String(await verdict(page).textContent()), /^not computed/);
  await page.getByText("jostle check FILE.html").waitFor();
  await page.getByText(claim.state_hash).waitFor();
});

test("a run is equal, a variant claims nothing, and an altered file is different", {
  skip,
}, async () => {
  const content = await exportRun();
  const page = await open(content, readEngine());
  const said = async (text: RegExp) =>
    until(String(text), async () => text.test((await verdict(page).textContent()) ?? ""));
  await said(/^equal after 5,000 steps$/);
  const hashes = await page.locator(".claim code").allTextContents();
  assert.deepEqual(hashes, [content.claim!.state_hash, content.claim!.state_hash]);
  await slider(page).press("End");
  assert.equal(await slider(page).getAttribute("aria-valuetext"), "t 100.00 · step 5,000");
  for (const [name, value] of Object.entries({ n: "50", seed: "3", pi1: "4" })) {
    assert.equal(await page.getByLabel(name, { exact: true }).inputValue(), value, name);
  }
  await page.getByLabel("pi3").fill("5");
  await page.getByRole("button", { name: "Run your variant" }).click();
  const variant = page.getByText("your variant, pi3 = 5: computed. Nothing is claimed about it");
  await variant.waitFor();
  assert(!(await variant.textContent())?.includes(content.claim!.state_hash));
  // The verdict is about the published run, which the picture does not show.
  const head = page.locator(".page-head .verdict");
  assert.equal(await head.textContent(), "your variant: nothing is claimed");
  assert.equal(await head.getAttribute("data-verdict"), "none");
  await said(/^equal after 5,000 steps$/);
  await page.getByLabel("pi3").fill("-5");
  await page.getByRole("button", { name: "Run your variant" }).click();
  // The browser rejects the value.
  assert(
    await page.getByLabel("pi3").evaluate((it) => (it as HTMLInputElement).matches(":invalid")),
  );
  await page.getByRole("button", { name: "Back to the published run" }).click();
  assert.equal(await head.textContent(), "equal after 5,000 steps");
  await page.getByText("SHA-256 of the engine").waitFor({ state: "attached" });

  const toml = content.files!.toml.replace("direction = 0.4,", "direction = 0.41,");
  const altered = await open({ ...content, name: "altered", files: { toml } }, readEngine());
  const text = verdict(altered);
  await until("different", async () => /^different/.test((await text.textContent()) ?? ""));
  assert.equal(await text.textContent(), "different after 5,000 steps");
});

test("a fault that ends a run is said, and is a part of what is compared", { skip }, async () => {
  const toml =
    'name = "fault"\nseeds = [0]\nduration = 10\n[spec]\nn = 60\npi1 = 16.0\n' +
    'attraction = { kind = "power", exponent = 8.0 }\n';
  const base: Content = { ...BASE, kind: "run", name: "fault", files: { toml } };
  const run = { index: 0, name: "#0" };
  const claim = { steps: 1, state_hash: "ab" };
  const said = async (content: Content) => {
    const page = await open(content, readEngine());
    const text = await until("a verdict", async () => {
      const text = await verdict(page).textContent();
      return /^(equal|different)/.test(text ?? "") && text;
    });
    return { text, panel: (await page.locator(".claim .verify").textContent()) ?? "", page };
  };
  const { text, page } = await said({ ...base, run, claim });
  const found = /^different: the run ended after 1 step \((.*)\), the published one after 1 step$/;
  const fault = found.exec(text)?.[1];
  assert(fault, text);
  const state_hash = (await page.locator(".claim code").allTextContents())[1]!;
  const equal = await said({ ...base, run, claim: { ...claim, state_hash, fault } });
  assert.equal(equal.text, "equal after 1 step");
  assert(equal.panel.includes(`Both runs ended early: ${fault}.`), equal.panel);
  const named = await open({ ...base, run: { index: 0, name: "#1" }, claim }, readEngine());
  await named
    .getByText('not computed: the experiment has no run "#1" with the number 1')
    .first()
    .waitFor();
});

test("a file that was cut off says so, and a whole one does not", async () => {
  const page = await open({ ...RECORDING, name: "whole" }, null);
  assert.equal(await page.getByText("Reading the file").count(), 0);
  const path = join(folder, "whole.html");
  truncateSync(path, readFileSync(path).indexOf("jostle-module"));
  await page.reload();
  await page.getByText("the file is incomplete or was altered: copy it again").waitFor();
});

test("a second variant ends the first one", { skip }, async () => {
  const content = await exportRun();
  const page = await open(content, readEngine());
  const run = async (duration: string) => {
    await page.getByLabel("duration").fill(duration);
    await page.getByRole("button", { name: "Run your variant" }).click();
  };
  await run("19999");
  await page.getByText(/^your variant: step \d/).waitFor();
  await run("1");
  const computed = page.getByText("your variant, duration = 1: computed");
  await computed.waitFor();
  await page.waitForTimeout(300);
  assert(await computed.isVisible());
});

test("a damaged engine is an error that is said", { skip }, async () => {
  const page = await open(await exportRun(), readEngine().subarray(0, 5000));
  await until("an error", async () =>
    /^not computed/.test((await verdict(page).textContent()) ?? ""),
  );
});

for (const colorScheme of ["light", "dark"] as const) {
  for (const width of [1280, 390]) {
    test(`the player is accessible, ${colorScheme}, ${width} pixels wide`, async () => {
      const viewport = { width, height: 844 };
      const page = await open(RECORDING, null, { viewport, colorScheme });
      await page.getByText("About this file").click();
      await page.getByText("Licences", { exact: true }).click();
      await page.getByText("the licences").waitFor();
      await check(page, "recording");
      const scrollWidth = await page.evaluate(() => document.documentElement.scrollWidth);
      assert(scrollWidth <= width, `${scrollWidth} pixels`);
      if (!skip) {
        const run = await open(await exportRun(), readEngine(), { viewport, colorScheme });
        await until("equal", async () => /^equal/.test((await verdict(run).textContent()) ?? ""));
        await run.getByText("The experiment file").click();
        await check(run, "run");
      }
    });
  }
}
