/** The list, the gallery and the theme. */
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Page } from "playwright-core";
import { until } from "./browser.ts";
import { number, Site } from "./site.ts";

const site = new Site();

test("the list shows a swarm, and a click opens its page", async () => {
  await site.daemon.command("school", "run");
  const page = await site.open("/");
  const card = page.locator('[data-swarm="school"]');
  await card.waitFor();
  await until("the phase", async () => (await card.textContent())?.includes("running"));
  assert.match((await card.textContent()) ?? "", /n 40/);
  const line = card.locator("polyline");
  await until("a sparkline", async () => ((await line.getAttribute("points")) ?? "").includes(" "));
  await card.click();
  await page.locator("h1", { hasText: "school" }).waitFor();
});

test("a sparkline starts when the page is opened, and grows", async () => {
  const points = async (page: Page) => {
    const line = page.locator('[data-swarm="school"] .sparkline polyline');
    return ((await line.getAttribute("points")) ?? "").split(" ").length;
  };
  const before = await site.open("/");
  await until("a few", async () => (await points(before)) > 10);
  const page = await site.open("/");
  await page.locator('[data-swarm="school"]').waitFor();
  assert((await points(page)) < 5);
  await until("more", async () => (await points(page)) > 5);
});

test("the theme follows the system until it is switched", async () => {
  const page = await site.open("/");
  const theme = () => page.evaluate("document.documentElement.dataset.theme");
  assert.equal(await theme(), "light");
  await page.emulateMedia({ colorScheme: "dark" });
  await until("dark", async () => (await theme()) === "dark");
  await page.getByRole("button", { name: "switch to light" }).click();
  assert.equal(await theme(), "light");
  await page.reload();
  assert.equal(await theme(), "light");
});

test("the gallery creates an animation with one click, and shows an existing one", async () => {
  const tab = await site.openTabAt("/gallery");
  // A thumbnail may be requested while the swarm is deleted.
  tab.allowsError(/^404 GET \/api\/get\/animation-6-discs\/(state|get\/status)$/);
  const { page } = tab;
  const card = page.locator('[data-swarm="animation-6-discs"]');
  await card.getByRole("button", { name: "Create and run" }).click();
  await page.locator("h1", { hasText: "discs" }).waitFor();
  await until("it runs", async () => (await site.row("animation-6-discs"))?.phase === "running");
  await until("its order", async () => Number(await number(page, "order").textContent()) >= 0);
  await page.getByText("What to look for").waitFor();
  await page.goto(`${site.daemon.addresses.http}/#/gallery`);
  await card.getByRole("button", { name: "Show" }).waitFor();
  await site.daemon.command("animation-6-discs", "delete");
  // Until the daemon's list is without it, another tab would request its thumbnail.
  await card.getByRole("button", { name: "Create and run" }).waitFor();
});

test("no page is wider than a phone's screen", async () => {
  for (const hash of ["/", "/swarm/school", "/gallery", "/gallery/animation-1"]) {
    const tab = await site.openTab({ viewport: { width: 360, height: 740 }, hasTouch: true });
    if (hash === "/gallery/animation-1") {
      // No such swarm exists: the page may request its parameters before the list arrives.
      tab.allowsError(/^404 GET \/api\/get\/animation-1\/get\/parameters$/);
    }
    await tab.page.goto(`${site.daemon.link}&${hash}`);
    await tab.page.locator("h1").first().waitFor();
    await tab.page.waitForTimeout(300);
    assert.equal(await tab.page.evaluate("document.documentElement.scrollWidth"), 360, hash);
  }
});
