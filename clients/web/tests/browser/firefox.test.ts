/** The engine in Firefox: a swarm is verified, and a file from the disk confirms its hash. */
import assert from "node:assert/strict";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import puppeteer, { type Browser, type Page } from "puppeteer-core";
import { until } from "./browser.ts";
import { lacks, lacksEngine, readEngine } from "./engine.ts";
import { exportRun, writePlayer } from "./player.ts";
import { Site } from "./site.ts";

const executablePath = process.env.FIREFOX ?? "/usr/bin/firefox-esr";
const remedy = `no firefox at ${executablePath}: apt-get install firefox-esr, or set FIREFOX`;
const skip =
  lacks("firefox", existsSync(executablePath), remedy, "firefox.test.ts") ||
  lacksEngine("firefox.test.ts");

const site = new Site();
const folder = mkdtempSync(join(tmpdir(), "jostle-firefox-"));
let browser: Browser | undefined;

before(async () => {
  if (!skip) {
    browser = await puppeteer.launch({
      browser: "firefox",
      executablePath,
      headless: true,
      // Setting the size needs a later version than Debian's.
      defaultViewport: null,
    });
  }
});

after(async () => {
  await browser?.close();
  rmSync(folder, { recursive: true });
});

/** Opens a page; returns it, with the errors of its scripts. */
async function open(address: string): Promise<{ page: Page; errors: string[] }> {
  const page = await browser!.newPage();
  const errors: string[] = [];
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("console", (message) => {
    if (message.type() === "error") {
      errors.push(message.text());
    }
  });
  await page.goto(address);
  return { page, errors };
}

/** Waits until an element has a text of this pattern; returns the text. */
const said = (page: Page, selector: string, pattern: RegExp) =>
  until(String(pattern), async () => {
    const texts = await page.$$eval(selector, (all) => all.map((it) => it.textContent ?? ""));
    return texts.find((it) => pattern.test(it));
  });

test("a swarm of 5000 steps is verified in under 10 s", { skip }, async () => {
  await site.daemon.create("demo", { n: 50, seed: 3 });
  await site.daemon.command("demo", "inform", { select: { count: 10 }, direction: 0.4 });
  await site.daemon.command("demo", "step", { steps: 5000 });
  const { page, errors } = await open(`${site.daemon.addresses.http}/#/swarm/demo`);
  const button = "::-p-aria([name='Verify in your browser'][role='button'])";
  await page.waitForSelector(button, { visible: true });
  const began = performance.now();
  await page.click(button);
  await said(page, ".verify [role=status]", /^equal after 5,000 steps: /);
  assert(performance.now() - began < 10_000);
  assert.deepEqual(errors, []);
});

test("a file confirms its hash, and an altered one does not", { skip }, async () => {
  const content = await exportRun();
  const { page, errors } = await open(writePlayer(folder, content, readEngine()));
  await said(page, ".claim [role=status]", /^equal after 5,000 steps$/);
  const toml = content.files!.toml.replace("direction = 0.4,", "direction = 0.41,");
  const altered = writePlayer(
    folder,
    { ...content, name: "altered", files: { toml } },
    readEngine(),
  );
  const other = await open(altered);
  await said(other.page, ".claim [role=status]", /^different after 5,000 steps$/);
  assert.deepEqual([...errors, ...other.errors], []);
});
