/** The picture keeps a least height and all its tools in windows of each size. */
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Page } from "playwright-core";
import { until } from "./browser.ts";
import { Site, step } from "./site.ts";

const SIZES = [
  [1920, 1080],
  [1280, 800],
  [1024, 768],
  [1024, 600],
  [768, 1024],
  [390, 844],
  [844, 390],
  [320, 568],
] as const;

/** The least height of the picture; in windows lower than LOW, of phones on their side, less. */
const LEAST = 350;
const LEAST_LOW = 240;
const LOW = 500;

const TOOLS = [
  "Follow",
  "Contacts",
  "Clusters",
  "Trails",
  "Preferences",
  "Lasso",
  "Zoom in",
  "Zoom out",
];

const CHARTS = [
  ...["order", "drift", "contacts", "real_time_factor", "nematic", "milling"],
  ...["spread", "clusters.count", "clusters.largest", "neighbour_gap.median"],
];

const site = new Site();

let filled: Promise<void> | undefined;

/** Adds other swarms, and a long list of events. */
async function fill(): Promise<void> {
  for (let k = 0; k < 12; k += 1) {
    await site.daemon.create(`other-${k}`, { n: 20, seed: k });
  }
  await site.daemon.create("animation-1", { n: 50, seed: 1 });
  for (let k = 0; k < 60; k += 1) {
    await site.daemon.command("school", "set", { publish_every: 5 + (k % 2) });
  }
  await site.daemon.command("school", "inform", { select: { count: 10 }, direction: 1 });
  await site.daemon.command("school", "run");
}

interface Layout {
  picture: { width: number; height: number };
  /** The names of the tools that a click reaches. */
  reached: string[];
  /** By how much the page is wider and higher than the window. */
  beyond: [number, number];
}

/** Runs in the page: scrolls to the picture as a user would, and measures. */
function measure(): Layout {
  const view = document.querySelector("figure.view")!;
  view.scrollIntoView({ block: "nearest" });
  const { width, height, left, top, right, bottom } = view.getBoundingClientRect();
  const reached = [...view.querySelectorAll(".toolbar button")].filter((button) => {
    const box = button.getBoundingClientRect();
    const isInside =
      box.left >= left && box.top >= top && box.right <= right && box.bottom <= bottom;
    const places = [
      [box.left + 8, box.top + 8],
      [box.right - 8, box.bottom - 8],
    ] as const;
    return isInside && places.every(([x, y]) => button.contains(document.elementFromPoint(x, y)));
  });
  const { scrollWidth, scrollHeight } = document.documentElement;
  return {
    picture: { width, height },
    reached: reached.map((it) => it.getAttribute("aria-label") ?? ""),
    beyond: [scrollWidth - innerWidth, scrollHeight - innerHeight],
  };
}

async function check(page: Page, width: number, height: number, where: string): Promise<void> {
  const { picture, reached, beyond } = await page.evaluate(measure);
  const least = height < LOW ? LEAST_LOW : LEAST;
  assert(picture.height >= least, `${where}: the picture is ${picture.height} pixels high`);
  assert(picture.width >= Math.min(0.55 * width, width - 40), `${where}: ${picture.width} wide`);
  assert.deepEqual(reached, TOOLS, where);
  assert(beyond[0] <= 0, `${where}: the page is ${beyond[0]} pixels too wide`);
  // The picture and the panels of a wide window scroll, not the window.
  assert(width < 1000 || beyond[1] <= 0, `${where}: the page is ${beyond[1]} pixels too high`);
}

for (const [width, height] of SIZES) {
  test(`the picture and its tools at ${width} × ${height}`, async () => {
    filled ??= fill();
    await filled;
    const { page } = await site.openTabAt("/swarm/school", true, { viewport: { width, height } });
    await until("a state", () => step(page));
    await page.locator(".events li").nth(50).waitFor({ state: "attached" });
    await check(page, width, height, "as opened");
    await page.evaluate((names) => sessionStorage.setItem("charts", names), JSON.stringify(CHARTS));
    await page.reload();
    await until("a state", () => step(page));
    await page.locator(".chart").nth(9).waitFor({ state: "attached" });
    await check(page, width, height, "with ten charts");
    await page.locator(".chart-menu summary").click();
    await page.locator(".choices label", { hasText: "spread" }).waitFor();
    await check(page, width, height, "with the menu of charts");
    // The last tool is one that can be used.
    const picture = page.locator("canvas.picture");
    const scale = async () => Number(await picture.getAttribute("data-scale"));
    const before = await scale();
    await page.getByRole("button", { name: "Zoom out" }).click();
    await until("a smaller scale", async () => (await scale()) < before);
    await page.goto(`${site.daemon.addresses.http}/#/gallery/animation-1`);
    await page.getByText("What to look for").waitFor();
    await check(page, width, height, "an animation");
  });
}
