/** The menu of charts: series and measures of the daemon. */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Locator, Page } from "playwright-core";
import { tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";

interface Measured {
  result: { measures: { name: string; value: number | null; unit: string }[] };
}

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
});

after(() => daemon.end());

async function open(swarm: string): Promise<Page> {
  const { page } = await openTab();
  await page.goto(`${daemon.link}&/swarm/${swarm}`);
  await page.locator(".chart").first().waitFor();
  return page;
}

const titles = (page: Page) => page.locator(".chart figcaption b").allTextContents();

const caption = async (page: Page, name: string) => {
  const chart = page.locator(".chart", { has: page.locator(`b:text-is("${name}")`) });
  return (await chart.locator("output").textContent()) ?? "";
};

test("the menu chooses the charts, and the tab keeps the choice", async () => {
  await daemon.create("chosen", { n: 20, seed: 3 });
  await daemon.command("chosen", "step", { steps: 200 });
  const page = await open("chosen");
  const all = ["order", "drift", "contacts", "real-time factor"];
  assert.deepEqual(await titles(page), all);
  await page.locator(".chart-menu summary").click();
  await page.getByLabel("clusters.largest").check();
  await page.getByLabel("neighbour_gap.median").check();
  await page.getByRole("checkbox", { name: "contacts", exact: true }).uncheck();
  const now = ["order", "drift", "real-time factor", "clusters.largest", "neighbour_gap.median"];
  assert.deepEqual(await titles(page), now);
  const { result } = await daemon.get<Measured>("chosen/get/measures?names=clusters.largest");
  const largest = `${result.measures[0]!.value} individuals`;
  await until("a value", async () => (await caption(page, "clusters.largest")) === largest);
  // The measures of a paused swarm follow its commands.
  await daemon.command("chosen", "remove", { select: { count: 19 } });
  const one = async () => (await caption(page, "clusters.largest")) === "1 individuals";
  await until("the cluster of one", one);
  const none = page.locator(".chart .none", { hasText: /undefined|no common direction/ });
  assert.equal(await caption(page, "neighbour_gap.median"), "–");
  assert.equal(await none.filter({ visible: true }).count(), 2, "the drift and the gap");
  await page.reload();
  await until("the same charts", async () => (await titles(page)).join() === now.join());
  // A request in flight for a deleted swarm would be an error.
  await page.goto("about:blank");
  await daemon.command("chosen", "delete");
});

test("the measures of a running swarm are requested at most twice a second, in one request", async () => {
  await daemon.create("running", { n: 30, seed: 4, rate: 20, publish_every: 2 });
  await daemon.command("running", "run");
  const page = await open("running");
  await page.locator(".chart-menu summary").click();
  for (const name of ["milling", "nematic"]) {
    await page.getByLabel(name, { exact: true }).check();
  }
  await until("a value", async () => /\d/.test(await caption(page, "nematic")));
  const sent: string[] = [];
  page.on("request", (request) => {
    if (request.url().includes("/get/measures?")) {
      sent.push(request.url());
    }
  });
  await page.waitForTimeout(3000);
  assert(sent.length >= 2 && sent.length <= 7, `${sent.length} requests in 3 s`);
  assert(
    sent.every((url) => url.endsWith("names=milling,nematic")),
    sent[0],
  );
  for (const name of ["milling", "nematic"]) {
    await page.getByLabel(name, { exact: true }).uncheck();
  }
  await page.waitForTimeout(700);
  sent.length = 0;
  await page.waitForTimeout(1200);
  assert.deepEqual(sent, []);
  await daemon.command("running", "delete");
});

test("the text in place of a line covers no label of the axes", async () => {
  await daemon.create("bare", { n: 20, seed: 3 });
  await daemon.command("bare", "step", { steps: 200 });
  const page = await open("bare");
  for (const [width, height] of [
    [1280, 800],
    [360, 740],
  ] as const) {
    await page.setViewportSize({ width, height });
    const chart = page.locator(".chart", { has: page.locator('b:text-is("drift")') });
    await chart.scrollIntoViewIfNeeded();
    const box = async (part: Locator) => (await part.boundingBox())!;
    await until("it is beside the labels", async () => {
      const [text, plot, all] = await Promise.all(
        [chart.locator(".none"), chart.locator(".u-over"), chart].map(box),
      );
      return (
        text!.x >= plot!.x &&
        text!.x + text!.width <= all!.x + all!.width &&
        text!.y >= plot!.y &&
        text!.y + text!.height <= plot!.y + plot!.height
      );
    });
  }
});
