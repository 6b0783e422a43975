/** The page of a swarm: keys, lasso, parameters and notes. */
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { until } from "./browser.ts";
import { drag, Site, step } from "./site.ts";

const site = new Site();

test("the page of a running swarm updates its numbers and pictures", async () => {
  await site.daemon.command("school", "run");
  const page = await site.open("/swarm/school");
  const first = await until("a step", () => step(page));
  await until("later steps", async () => (await step(page)) > first + 50);
  const fps = page.locator(".meter");
  await until("pictures", async () => Number(await fps.getAttribute("data-fps")) > 5);
  assert.equal(
    await page.getByRole("button", { name: "Follow" }).getAttribute("aria-pressed"),
    "true",
  );
  assert.equal(await page.evaluate("location.href.includes('token')"), false);
  assert.equal(await page.evaluate("localStorage.length"), 0);
});

test("space pauses and runs, s executes one step", async () => {
  await site.daemon.command("school", "run");
  const page = await site.open("/swarm/school");
  const runs = page.locator("button.wide");
  await until("the button", async () => (await runs.textContent())?.includes("Pause"));
  await page.locator("canvas.picture").focus();
  await page.keyboard.press(" ");
  await until("a pause", async () => (await site.row("school"))?.phase === "paused");
  await until("its button", async () => (await runs.textContent())?.includes("Run"));
  const before = (await site.state("school")).step;
  await page.keyboard.press("s");
  await until("a step", async () => (await site.state("school")).step === before + 1);
  await until("its number", async () => (await step(page)) === before + 1);
  await page.keyboard.press(" ");
  await until("running", async () => (await site.row("school"))?.phase === "running");
});

test("keys toggle contacts, clusters and trails, and stop and resume following", async () => {
  const page = await site.open("/swarm/school");
  await until("a state", () => step(page));
  const pressed = (name: string) =>
    page.getByRole("button", { name, exact: true }).getAttribute("aria-pressed");
  for (const [key, name] of [
    ["c", "Contacts"],
    ["k", "Clusters"],
    ["t", "Trails"],
  ] as const) {
    await page.keyboard.press(key);
    assert.equal(await pressed(name), "true");
  }
  await page.keyboard.press("ArrowLeft");
  assert.equal(await pressed("Follow"), "false");
  await page.keyboard.press("f");
  assert.equal(await pressed("Follow"), "true");
  const scale = async () => Number(await page.locator("canvas.picture").getAttribute("data-scale"));
  // The key `f` changes the scale over several frames.
  const fitted = await until("a scale that stays", async () => {
    const before = await scale();
    await page.evaluate(
      () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))),
    );
    return (await scale()) === before && before;
  });
  await page.keyboard.press("+");
  await until("a larger scale", async () => (await scale()) > fitted);
  await page.keyboard.press("?");
  await page.locator("dialog").waitFor();
  await page.keyboard.press("Escape");
  await until("no dialog", async () => (await page.locator("dialog").count()) === 0);
});

test("a lasso informs exactly the individuals that it encloses", async () => {
  await site.daemon.create("herd", { n: 30, seed: 8, pi1: 4 });
  await site.daemon.command("herd", "step", { steps: 200 });
  const page = await site.open("/swarm/herd");
  await until("a state", () => step(page));
  const at = await site.state("herd");
  const canvas = page.locator("canvas.picture");
  const box = (await canvas.boundingBox())!;
  const scale = Number(await canvas.getAttribute("data-scale"));
  const mean = (column: number[]) => column.reduce((sum, it) => sum + it, 0) / column.length;
  const [mx, my] = [mean(at.x), mean(at.y)];
  const screen = at.id.map((id, i) => ({
    id,
    left: box.width / 2 + (at.x[i]! - mx) * scale,
    top: box.height / 2 - (at.y[i]! - my) * scale,
  }));
  // A triangle around part of the group, its sides away from all centres.
  const corners = [
    [box.width * 0.5, box.height * 0.02],
    [box.width * 0.04, box.height * 0.6],
    [box.width * 0.62, box.height * 0.95],
  ] as const;
  const expected = screen.filter((it) => inTriangle(it.left, it.top, corners)).map(({ id }) => id);
  assert(expected.length > 2 && expected.length < 28, `${expected.length} are enclosed`);

  await page.keyboard.press("l");
  await drag(page, box, [...corners, corners[0]]);
  await page.getByText(`${expected.length} individuals selected`).waitFor();
  await page.getByLabel("weight").fill("0.75");
  // The direction: up and to the right, 45 degrees from +x.
  await drag(page, box, [
    [100, 200],
    [180, 120],
  ]);
  const informed = await until("informed individuals", async () => {
    const now = await site.state("herd");
    return now.weight.some((it) => it > 0) && now;
  });
  assert.deepEqual(
    informed.id.filter((_, i) => informed.weight[i]! > 0),
    expected,
  );
  informed.weight.forEach((weight, i) => {
    assert.equal(weight, expected.includes(informed.id[i]!) ? 0.75 : 0);
    if (weight > 0) {
      assert(Math.abs(informed.direction[i]! - Math.PI / 4) < 1e-6);
    }
  });
  await page.locator("button", { hasText: "Uninform" }).click();
  await until("no individual is informed", async () =>
    (await site.state("herd")).weight.every((it) => it === 0),
  );
});

test("the commands of a swarm are downloaded as the file of an experiment", async () => {
  await site.daemon.command("herd", "step", { steps: 10 });
  const page = await site.open("/swarm/herd");
  const download = page.waitForEvent("download");
  await page.getByRole("button", { name: "Download as experiment" }).click();
  const file = await download;
  assert.equal(file.suggestedFilename(), "herd.toml");
  const text = await readFile(await file.path(), "utf8");
  assert.match(text, /^name = "herd"$/m);
  assert.match(text, /^step = 200 .*\ninform = \{.*weight = 0\.75.*\}$/m);
  assert.match(text, /^uninform = /m);
});

test("a parameter is set, and a rejection shows the daemon's message", async () => {
  const tab = await site.openTabAt("/swarm/herd");
  tab.expectsError(/^400 POST \/api\/cmd\/herd\/set$/);
  const { page } = tab;
  const field = page.getByLabel("pi3", { exact: true });
  await field.fill("1.5");
  await page.getByRole("button", { name: "set pi3" }).click();
  const parameter = page.locator(".parameter", { hasText: "Body size over turning radius" });
  await until("its value", async () => (await parameter.locator("output").textContent()) === "1.5");
  await field.fill("0");
  await page.getByRole("button", { name: "set pi3" }).click();
  await page.locator(".errors", { hasText: "pi3" }).waitFor();
  const applied = page.locator(".events li", { hasText: "set pi3 1.5" });
  await applied.waitFor();
  const clock = applied.locator(".clock");
  const at = await clock.getAttribute("title");
  assert.ok(Math.abs(Date.parse(at ?? "") - Date.now()) < 60_000, `the event has the time ${at}`);
  assert.equal(await clock.textContent(), `${at?.slice(11, 19)}Z`);
});

test("a note is added and appears among the events", async () => {
  const page = await site.open("/swarm/herd");
  const field = page.getByLabel("note in the journal");
  await field.fill("lights off, s and space are no shortcuts here");
  await page.getByRole("button", { name: "Add note" }).click();
  const noted = page.locator(".events li", { hasText: "note: lights off, s and space" });
  await noted.waitFor();
  await until("an empty field", async () => (await field.inputValue()) === "");
});

test("after a lasso the key d stays in the direction mode", async () => {
  await site.daemon.command("school", "pause");
  const page = await site.open("/swarm/school");
  await page.locator("canvas.picture").waitFor();
  await page.keyboard.press("l");
  const { x, y, width, height } = (await page.locator("canvas.picture").boundingBox()) ?? {
    x: 0,
    y: 0,
    width: 0,
    height: 0,
  };
  const at = (share_x: number, share_y: number) =>
    page.mouse.move(x + share_x * width, y + share_y * height, { steps: 4 });
  await at(0.02, 0.02);
  await page.mouse.down();
  await at(0.8, 0.02);
  await at(0.8, 0.98);
  await at(0.02, 0.98);
  await at(0.02, 0.02);
  await page.mouse.up();
  await page.locator(".hint", { hasText: "Drag the direction" }).waitFor();
  await page.keyboard.press("d");
  await page.locator(".hint", { hasText: "Drag the direction" }).waitFor();
  await page.keyboard.press("Escape");
});

function inTriangle(
  x: number,
  y: number,
  corners: readonly (readonly [number, number])[],
): boolean {
  const sides = corners.map(([ax, ay], k) => {
    const [bx, by] = corners[(k + 1) % 3]!;
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax);
  });
  return sides.every((it) => it > 0) || sides.every((it) => it < 0);
}
