/** axe-core finds nothing serious or critical on any page, light and dark. */
import { test } from "node:test";
import { check } from "./axe.ts";
import { until } from "./browser.ts";
import { number, Site } from "./site.ts";

const site = new Site();

for (const colorScheme of ["light", "dark"] as const) {
  const options = { viewport: { width: 1280, height: 800 }, colorScheme };
  const narrow = { viewport: { width: 390, height: 844 }, colorScheme };

  test(`the list and the dialogs are accessible, ${colorScheme}`, async () => {
    const page = await site.open("/", true, options);
    await page.locator("[data-swarm]").first().waitFor();
    await check(page, "list");
    await page.getByLabel("filter by name").fill("nothing");
    await check(page, "empty list");
    await page.locator(".rights").click();
    await check(page, "token dialog");
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: "Create a swarm" }).click();
    await check(page, "create dialog");
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: "help" }).click();
    await check(page, "help");
  });

  test(`the page of a swarm is accessible, ${colorScheme}`, async () => {
    for (const size of [options, narrow]) {
      const opened = await site.openTabAt("/swarm/school", true, size);
      const { page } = opened;
      await until("a state", async () => (await number(page, "n").textContent()) === "40");
      await page.locator(".parameter").first().waitFor({ state: "attached" });
      await page.locator(".events li").first().waitFor();
      await check(page, `swarm, ${size.viewport.width} pixels wide`);
      await page.getByRole("button", { name: "Select all", exact: true }).click();
      await page.getByRole("button", { name: "Drag a direction" }).click();
      await check(page, "direction mode");
      const conditions = page.locator("details", { hasText: "When a condition holds" });
      if ((await conditions.getAttribute("open")) === null) {
        await conditions.locator("summary").click();
      }
      await page.locator(".conditions").getByLabel("action").selectOption("set");
      await page.getByLabel("condition", { exact: true }).fill("order > 2 >");
      opened.expectsError(/^400 POST \/api\/cmd\/school\/when$/);
      await page.getByRole("button", { name: "Add condition" }).click();
      await page.locator(".form-error").filter({ hasText: "expected" }).waitFor();
      await check(page, "an invalid condition");
    }
    const watching = await site.open("/swarm/school", false, options);
    await watching.getByText("this tab needs the daemon's token").first().waitFor();
    await check(watching, "swarm without a token");
    const tab = await site.openTabAt("/swarm/missing", true, options);
    tab.allowsError(/^404 GET \/api\/get\/missing\/get\//);
    await tab.page.getByText("No swarm missing on this daemon").waitFor();
    await check(tab.page, "missing swarm");
  });

  test(`the gallery and an animation are accessible, ${colorScheme}`, async () => {
    const page = await site.open("/gallery", true, options);
    await page.getByRole("button", { name: "Create and run" }).first().waitFor();
    await check(page, "gallery");
    const tab = await site.openTabAt("/gallery/animation-1", true, options);
    // The page may request the parameters before the list arrives.
    tab.allowsError(/^404 GET \/api\/get\/animation-1\/get\/parameters$/);
    await tab.page.getByText("What to look for").waitFor();
    await check(tab.page, "animation");
  });
}
