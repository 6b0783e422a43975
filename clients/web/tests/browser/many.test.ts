/** The list with 200 swarms: filter, sort order, keys, and thumbnails of the visible swarms only. */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { type Tab, tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";

const COUNT = 200;
/** Every fourth swarm is paused, every fifth is too large for a thumbnail. */
const isPaused = (k: number) => k % 4 === 0;
const isLarge = (k: number) => k % 5 === 0;
const MAX_PICTURES_PER_SECOND = 2;

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
  for (let k = 0; k < COUNT; k += 1) {
    const n = isLarge(k) ? 201 : 10 + (k % 3);
    await daemon.create(`swarm-${k}`, { n, seed: k, rate: 0.1, publish_every: 10 });
    if (!isPaused(k)) {
      await daemon.command(`swarm-${k}`, "run");
    }
  }
});

after(() => daemon.end());

/** The requests for states, by swarm, with their times. */
function recordStates(page: Page): Map<string, number[]> {
  const requests = new Map<string, number[]>();
  page.on("request", (request) => {
    const swarm = /\/api\/get\/([^/]+)\/state$/.exec(request.url())?.[1];
    if (swarm) {
      requests.set(swarm, [...(requests.get(swarm) ?? []), performance.now()]);
    }
  });
  return requests;
}

async function openList(query = ""): Promise<Tab> {
  const tab = await openTab();
  await tab.page.goto(`${daemon.link}&/${query}`);
  await tab.page.locator("[data-swarm]").first().waitFor();
  return tab;
}

const shown = (page: Page) =>
  page
    .locator(".swarm-card")
    .evaluateAll((cards) => cards.map((it) => it.getAttribute("data-swarm") ?? ""));

/** The swarms of the cards in the viewport. */
const visible = (page: Page) =>
  page.locator(".swarm-card").evaluateAll((cards) =>
    cards
      .filter((it) => {
        const { top, bottom } = it.getBoundingClientRect();
        return bottom > 0 && top < innerHeight;
      })
      .map((it) => it.getAttribute("data-swarm") ?? ""),
  );

const indexOf = (swarm: string) => Number(swarm.replace("swarm-", ""));

test("thumbnails are requested for visible swarms only, at most twice a second for each", async (t) => {
  const tab = await openTab();
  const { page } = tab;
  const requests = recordStates(page);
  await page.goto(`${daemon.link}&/`);
  await until("all cards", async () => (await shown(page)).length === COUNT);
  const seen = (await visible(page)).filter((it) => !isLarge(indexOf(it)));
  await until("all pictures", async () => seen.every((it) => requests.has(it)));
  const began = performance.now();
  await page.waitForTimeout(5000);
  const secs = (performance.now() - began) / 1000;

  const unexpected = [...requests.keys()].filter((it) => !seen.includes(it));
  assert.deepEqual(unexpected, [], "requests for invisible or large swarms");
  for (const [swarm, times] of requests) {
    if (isPaused(indexOf(swarm))) {
      assert.equal(times.length, 1, `requests for ${swarm}, which is paused`);
      continue;
    }
    const late = times.filter((it) => it >= began).length;
    assert(late > 0, `${swarm} has ${late} new pictures`);
    assert(late <= MAX_PICTURES_PER_SECOND * secs + 1, `${swarm} has ${late} in ${secs} s`);
  }
  const drawn = await page.locator("canvas[data-step]").count();
  assert.equal(drawn, seen.length, "each visible swarm has a picture");
  const total = [...requests.values()].flat().filter((it) => it >= began).length;
  t.diagnostic(`${(total / secs).toFixed(1)} states a second for ${seen.length} swarms`);

  // Other cards move into the viewport: requests follow.
  await page.evaluate("scrollTo(0, document.documentElement.scrollHeight)");
  const last = `swarm-${COUNT - 1}`;
  await until("a picture of the last swarm", async () => requests.has(last));
  await page.waitForTimeout(1000);
  requests.clear();
  await page.waitForTimeout(2000);
  const left = [...requests.keys()].filter((it) => seen.includes(it));
  assert.deepEqual(left, [], "swarms that have left the viewport");

  // One command on a paused swarm gives one picture.
  const paused = (await visible(page)).find(
    (it) => isPaused(indexOf(it)) && !isLarge(indexOf(it)),
  )!;
  requests.clear();
  await daemon.command(paused, "step", { steps: 3 });
  const canvas = page.locator(`[data-swarm="${paused}"] canvas`);
  await until("its step", async () => (await canvas.getAttribute("data-step")) === "3");
  await page.waitForTimeout(1500);
  assert.equal(requests.get(paused)?.length, 1);
});

test("with thumbnails of 200 swarms the page keeps its frame rate", async (t) => {
  const { page } = await openList();
  await page.locator("canvas[data-step]").first().waitFor();
  await page.waitForTimeout(2000);
  const rest = await page.evaluate<number>(`new Promise((resolve) => {
    let frames = 0;
    const end = performance.now() + 3000;
    const count = (now) => (now < end ? (frames += 1, requestAnimationFrame(count)) : resolve(frames / 3));
    requestAnimationFrame(count);
  })`);
  const tasks = await page.evaluate<number>(`new Promise((resolve) => {
    let busy = 0;
    const observer = new PerformanceObserver((list) => {
      busy += list.getEntries().reduce((sum, it) => sum + it.duration, 0);
    });
    observer.observe({ type: "longtask" });
    setTimeout(() => resolve(busy / 3000), 3000);
  })`);
  t.diagnostic(`${rest.toFixed(0)} frames a second, ${(100 * tasks).toFixed(0)} % in long tasks`);
  // Half the time in tasks of more than 50 ms would be noticeable; an idle machine has none.
  assert(tasks < 0.5, `${(100 * tasks).toFixed(0)} % of the time in long tasks`);
});

test("the list is filtered and sorted, and the URL remembers it", async () => {
  const { page } = await openList();
  await until("all cards", async () => (await shown(page)).length === COUNT);
  assert.deepEqual((await shown(page)).slice(0, 3), ["swarm-0", "swarm-1", "swarm-2"]);
  await page.keyboard.press("/");
  await page.keyboard.type("19");
  const all = Array.from({ length: COUNT }, (_, k) => `swarm-${k}`);
  assert.deepEqual(
    await shown(page),
    all.filter((it) => it.includes("19")),
  );
  await page.getByLabel("show").selectOption("paused");
  await page.getByLabel("sort by").selectOption("n");
  await page.getByRole("button", { name: "sort order" }).click();
  const expected = ["swarm-196", "swarm-192"];
  assert.deepEqual(await shown(page), expected);
  await page.getByText("2 of 200 on").waitFor();
  assert.match(page.url(), /#\/\?q=19&show=paused&sort=-n$/);

  await page.reload();
  await page.locator("[data-swarm]").first().waitFor();
  assert.deepEqual(await shown(page), expected);
  await page.locator(".swarm-card").first().click();
  await page.locator("h1", { hasText: "swarm-196" }).waitFor();
  await page.goBack();
  await page.locator("h1", { hasText: "Swarms" }).waitFor();
  await until("the filtered list", async () => (await shown(page)).length === 2);

  await page.getByLabel("filter by name").fill("nothing");
  await page.getByText("No swarm matches the filter.").waitFor();
  await page.getByRole("button", { name: "Show all swarms" }).click();
  await until("all cards", async () => (await shown(page)).length === COUNT);
});

test("the list is used with the keyboard alone", async () => {
  const { page } = await openList("?q=swarm-1");
  const focused = () => page.evaluate("document.activeElement?.getAttribute('data-swarm')");
  await page.keyboard.press("/");
  await page.keyboard.press("ArrowDown");
  assert.equal(await focused(), "swarm-1");
  await page.keyboard.press("ArrowRight");
  assert.equal(await focused(), "swarm-10");
  await page.keyboard.press("ArrowDown");
  const below = await focused();
  assert.notEqual(below, "swarm-10");
  // While a card has the focus, the order of the cards does not change under it.
  await page.waitForTimeout(1500);
  assert.equal(await focused(), below);
  await page.keyboard.press("End");
  assert.equal(await focused(), "swarm-199");
  await page.keyboard.press("Home");
  await page.keyboard.press("Enter");
  await page.locator("h1", { hasText: "swarm-1" }).waitFor();
});
