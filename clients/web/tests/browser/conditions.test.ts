/** The form of conditions: pause or change a swarm once a condition holds. */
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Page } from "playwright-core";
import { until } from "./browser.ts";
import { Site, step } from "./site.ts";

const site = new Site();

async function waiting(page: Page): Promise<(string | null)[]> {
  return page.locator(".waiting li code").allTextContents();
}

/** Fills in the form without a pointer: each field is reached with Tab. */
async function add(page: Page, condition: string): Promise<void> {
  // It accepts no condition before the reply to the one before.
  await page.locator(".conditions form:not([aria-busy])").waitFor();
  await page.getByLabel("condition", { exact: true }).fill(condition);
  await page.getByLabel("condition", { exact: true }).press("Enter");
}

test("a condition pauses a swarm, and is listed until then", async () => {
  await site.daemon.create("school-2", { n: 20, seed: 3, dt: 0.05 });
  const page = await site.open("/swarm/school-2");
  await until("a state", async () => (await step(page)) === 0);
  await page.getByText("No condition waits.").waitFor();
  assert.equal(await page.getByRole("button", { name: "Remove all" }).isVisible(), false);
  await add(page, "order>=0 for 1");
  await until("it waits", async () => (await waiting(page)).join() === "order >= 0 for 1");
  assert.equal(await page.getByLabel("condition", { exact: true }).inputValue(), "");
  await site.daemon.command("school-2", "run", { rate: null });
  await until("a pause", async () => (await site.row("school-2"))?.phase === "paused");
  // From the first step on it has held for 20 steps.
  assert.equal((await site.state("school-2")).step, 21);
  await until("it waits no longer", async () => (await waiting(page)).length === 0);
});

test("a condition informs, uninforms and sets", async () => {
  const page = await site.open("/swarm/school-2");
  const panel = page.locator(".conditions");
  const action = panel.getByLabel("action");
  await action.selectOption("inform");
  await page.getByLabel("share").fill("0.5");
  await panel.getByLabel("direction").fill("90");
  await add(page, "order >= 0");
  await until("it waits", async () => (await waiting(page)).length === 1);
  await site.daemon.command("school-2", "step", { steps: 1 });
  const informed = await site.state("school-2");
  assert.equal(informed.weight.filter((it) => it > 0).length, 10);
  informed.direction.forEach((it, i) => {
    assert(informed.weight[i] === 0 || Math.abs(it - Math.PI / 2) < 1e-6);
  });
  await action.selectOption("set");
  await panel.getByLabel("parameter").selectOption("pi3");
  // All numbers that `set` changes but the shape, also later ones.
  const offered = await panel.getByLabel("parameter").getByRole("option").allTextContents();
  assert.deepEqual(offered.slice(0, 4), ["pi2", "pi3", "pi4", "noise"]);
  assert(!["n", "pi1", "dt", "publish_every"].some((it) => offered.includes(it)), String(offered));
  // The present value.
  assert.equal(await panel.getByLabel("value").inputValue(), "1");
  await panel.getByLabel("value").fill("1.75");
  await add(page, "drift > -2");
  await action.selectOption("uninform");
  await add(page, "order > 0.0001");
  await until("both wait", async () => (await waiting(page)).length === 2);
  await site.daemon.command("school-2", "step", { steps: 1 });
  await until("they wait no longer", async () => (await waiting(page)).length === 0);
  assert((await site.state("school-2")).weight.every((it) => it === 0));
  const pi3 = page.locator(".parameter", { hasText: "pi3" }).first().locator("output");
  await until("pi3", async () => (await pi3.textContent()) === "1.75");
});

test("conditions of other clients are listed, and all are removed", async () => {
  const page = await site.open("/swarm/school-2");
  await site.daemon.command("school-2", "when", { condition: "order < 1e-9", pause: true });
  await add(page, "milling > 0.999999");
  await until(
    "both",
    async () => (await waiting(page)).join() === "order < 1e-9,milling > 0.999999",
  );
  await page.getByText("pause, of page").waitFor();
  await page.getByRole("button", { name: "remove the condition order < 1e-9" }).click();
  await until("one", async () => (await waiting(page)).join() === "milling > 0.999999");
  await page.getByRole("button", { name: "Remove all" }).click();
  await until("none", async () => (await waiting(page)).length === 0);
  await page.getByText("No condition waits.").waitFor();
  const other = await site.open("/swarm/school-2");
  await site.daemon.command("school-2", "when", { condition: "order < 1e-9", pause: true });
  await until("another client's", async () => (await waiting(other)).join() === "order < 1e-9");
});

test("an error of a condition is beside the field, and its word is selected", async () => {
  const tab = await site.openTabAt("/swarm/school-2");
  tab.expectsError(/^400 POST \/api\/cmd\/school-2\/when$/);
  const { page } = tab;
  await add(page, "order > 0.5 and millin > 2");
  await page.locator(".form-error", { hasText: "milling" }).waitFor();
  const field = page.getByLabel("condition", { exact: true });
  const selected = await field.evaluate((it) => {
    const { value, selectionStart, selectionEnd } = it as HTMLInputElement;
    return value.slice(selectionStart ?? 0, selectionEnd ?? 0);
  });
  assert.equal(selected, "millin");
  assert.equal(await field.getAttribute("aria-invalid"), "true");
  await page.keyboard.type("milling");
  assert.equal(await field.inputValue(), "order > 0.5 and milling > 2");
  assert.equal(await page.locator(".form-error").isVisible(), false);
});

test("a viewer sees the conditions and cannot change them; 390 pixels are enough", async () => {
  const viewport = { width: 390, height: 844 };
  const page = await site.open("/swarm/school-2", false, { viewport });
  await page.getByText("When a condition holds").click();
  await until("the condition", async () => (await waiting(page)).length === 1);
  assert.equal(await page.getByLabel("condition", { exact: true }).isDisabled(), true);
  assert.equal(await page.getByRole("button", { name: "Remove all" }).isDisabled(), true);
  const [wide, seen] = await page.evaluate<[number, number]>(
    "[document.documentElement.scrollWidth, innerWidth]",
  );
  assert(wide <= seen, `${wide} > ${seen}`);
  const button = await page.getByRole("button", { name: "Download as experiment" }).boundingBox();
  assert(button && button.width < 250, `${button?.width}`);
});

test("a tab that gets the token later may remove the conditions that it lists", async () => {
  const page = await site.open("/swarm/school-2", false);
  const remove = page.getByRole("button", { name: "remove the condition order < 1e-9" });
  await remove.waitFor();
  assert.equal(await remove.isDisabled(), true);
  await page.locator(".rights").click();
  await page.locator("dialog input").fill(site.daemon.link);
  await page.locator("dialog button.primary").click();
  await until("permission", async () => !(await remove.isDisabled()));
  await remove.click();
  await page.getByText("No condition waits.").waitFor();
});
