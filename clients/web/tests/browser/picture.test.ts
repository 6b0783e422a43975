/** The picture, the numbers and the charts agree with the daemon. */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { type Tab, tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";

interface StateJson {
  step: number;
  id: number[];
  weight: number[];
  direction: number[];
}

interface Journal {
  result: { entries: { seq: number; verb: string }[] };
}

/** A drawn picture: the ends of each body's axis on the screen. */
interface Drawn {
  axes: [number, number, number, number][];
  crossed: number;
}

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
});

after(() => daemon.end());

async function openTabOf(swarm: string): Promise<Tab> {
  const tab = await openTab();
  await tab.page.addInitScript(recordBodies);
  await tab.page.goto(`${daemon.link}&/swarm/${swarm}`);
  await until("a picture", async () => (await drawn(tab.page)).length > 0);
  return tab;
}

const open = async (swarm: string) => (await openTabOf(swarm)).page;

/** Runs in the page: records the bodies' axes in each picture, from the canvas calls. */
function recordBodies(): void {
  const drawn: Drawn[] = [];
  Object.assign(globalThis, { drawn });
  let path: [number, number, number, number][] = [];
  let at: [number, number] = [0, 0];
  const { beginPath, moveTo, lineTo, stroke } = CanvasRenderingContext2D.prototype;
  const side = (ax: number, ay: number, bx: number, by: number, x: number, y: number) =>
    Math.sign((bx - ax) * (y - ay) - (by - ay) * (x - ax));
  const cross = ([a, b, c, d]: number[], [e, f, g, h]: number[]) =>
    side(a!, b!, c!, d!, e!, f!) * side(a!, b!, c!, d!, g!, h!) < 0 &&
    side(e!, f!, g!, h!, a!, b!) * side(e!, f!, g!, h!, c!, d!) < 0;
  Object.assign(CanvasRenderingContext2D.prototype, {
    beginPath(this: CanvasRenderingContext2D) {
      path = [];
      beginPath.call(this);
    },
    moveTo(this: CanvasRenderingContext2D, x: number, y: number) {
      at = [x, y];
      moveTo.call(this, x, y);
    },
    lineTo(this: CanvasRenderingContext2D, x: number, y: number) {
      path.push([...at, x, y]);
      at = [x, y];
      lineTo.call(this, x, y);
    },
    stroke(this: CanvasRenderingContext2D) {
      (stroke as () => void).call(this);
      // The edge and the interior stroke the same path; heads have no length.
      const [first] = path;
      const is_axes = first && Math.hypot(first[2] - first[0], first[3] - first[1]) > 1;
      if (this.lineCap === "round" && is_axes && drawn.at(-1)?.axes !== path) {
        let crossed = 0;
        path.forEach((one, i) => {
          for (const other of path.slice(0, i)) {
            crossed += cross(one, other) ? 1 : 0;
          }
        });
        drawn.push({ axes: path, crossed });
        if (drawn.length > 2000) {
          drawn.shift();
        }
      }
    },
  });
}

const drawn = (page: Page) => page.evaluate<Drawn[]>("drawn");
const number = (page: Page, name: string) =>
  page.locator(`dd[data-number="${name}"]`).first().textContent();
const step = async (page: Page) => Number(await number(page, "step"));
const state = (name: string) => daemon.get<StateJson>(`${name}/state?format=json`);
const informed = async (name: string) => {
  const { id, weight } = await state(name);
  return id.filter((_, i) => weight[i]! > 0);
};
/** The verbs of the commands that a swarm has applied. */
const verbs = async (name: string) =>
  (await daemon.get<Journal>(`${name}/get/journal`)).result.entries.map((it) => it.verb);
/** Whether the picture follows the swarm: panning ends that. */
const follows = (page: Page) =>
  page.getByRole("button", { name: "Follow" }).getAttribute("aria-pressed");

async function drag(page: Page, places: readonly (readonly [number, number])[]): Promise<void> {
  const box = (await page.locator("canvas.picture").boundingBox())!;
  const [first, ...rest] = places;
  await page.mouse.move(box.x + first![0], box.y + first![1]);
  await page.mouse.down();
  for (const [x, y] of rest) {
    await page.mouse.move(box.x + x, box.y + y, { steps: 6 });
  }
  await page.mouse.up();
}

const PULL = [
  [60, 250],
  [140, 170],
] as const;

test("at full speed no picture has crossing bodies, and the page shows that it does not interpolate", async (t) => {
  await daemon.create("fast", { n: 30, seed: 2, pi1: 4, rate: null, publish_every: 500 });
  await daemon.command("fast", "step", { steps: 2000 });
  const page = await open("fast");
  await daemon.command("fast", "run");
  await page.evaluate("drawn.length = 0");
  await until("many pictures", async () => (await drawn(page)).length >= 40, 60_000);
  const pictures = await drawn(page);
  const crossed = pictures.filter((it) => it.crossed > 0).length;
  t.diagnostic(`${pictures.length} pictures, ${crossed} with bodies that cross`);
  assert.equal(crossed, 0);
  const note = page.locator(".jumps");
  await note.filter({ hasText: "drawn states up to" }).waitFor();
  const apart = Number(/([\d.]+) time units apart/.exec((await note.textContent()) ?? "")?.[1]);
  assert(apart >= 10, `a state is published each 10 time units, not ${apart}`);

  // States close to one another are interpolated, without a note.
  await daemon.command("fast", "pause");
  await daemon.command("fast", "set", { publish_every: 10 });
  await daemon.command("fast", "run", { rate: 1 });
  await until("no note", async () => !(await note.isVisible()));
  const before = await step(page);
  await page.evaluate("drawn.length = 0");
  await page.waitForTimeout(2000);
  const states = ((await step(page)) - before) / 10;
  const shown = (await drawn(page)).length;
  t.diagnostic(`${shown} pictures of ${states} states`);
  assert(shown > 1.5 * states, `${shown} pictures of ${states} states`);
  assert((await drawn(page)).every((it) => it.crossed === 0));
  await daemon.command("fast", "delete");
});

test("a drag informs once, and the next one pans", async () => {
  await daemon.create("once", { n: 30, seed: 8 });
  const page = await open("once");
  const mode = () => page.locator("canvas.picture").getAttribute("data-mode");
  await page.getByRole("button", { name: "Select all", exact: true }).click();
  await page.getByRole("button", { name: "Drag a direction" }).click();
  await page.locator(".hint", { hasText: "Drag the direction" }).waitFor();
  assert.equal(await mode(), "direct");
  await drag(page, PULL);
  await page.locator(".notices", { hasText: "30 individuals informed: 45°" }).waitFor();
  assert.equal(await mode(), "look");
  assert.equal(await page.locator(".hint").isVisible(), false);
  assert.equal(await follows(page), "true");
  await drag(page, PULL);
  assert.equal(await follows(page), "false", "it pans");
  assert.deepEqual(await verbs("once"), ["inform"]);

  // The button Inform ends the mode, too.
  await page.keyboard.press("f");
  await page.getByRole("button", { name: "Drag a direction" }).click();
  await page.getByRole("button", { name: "Inform", exact: true }).click();
  await until("a second command", async () => (await verbs("once")).length === 2);
  await page.locator(".hint").waitFor({ state: "hidden" });
  await drag(page, PULL);
  assert.equal(await follows(page), "false", "it pans");
  await page.waitForTimeout(500);
  assert.deepEqual(await verbs("once"), ["inform", "inform"]);
  await daemon.command("once", "delete");
});

test("Esc and the Cancel button end a mode, also from a field and during a drag", async () => {
  await daemon.create("stop", { n: 12, seed: 8 });
  const page = await open("stop");
  const hint = page.locator(".hint");
  await page.getByRole("button", { name: "Select all", exact: true }).click();
  await page.getByRole("button", { name: "Drag a direction" }).click();
  await page.getByLabel("weight").fill("2");
  await page.keyboard.press("Escape");
  await hint.waitFor({ state: "hidden" });
  assert.equal(await page.getByLabel("weight").inputValue(), "2");
  await page.keyboard.press("Escape");
  await page.getByText("12 individuals selected").waitFor();

  await page.getByRole("button", { name: "Drag a direction" }).click();
  await hint.getByRole("button", { name: "Cancel" }).click();
  await hint.waitFor({ state: "hidden" });

  // The panel shows the mode, and its button ends it, too.
  const mode = page.locator(".steering .mode");
  await page.getByRole("button", { name: "Lasso", exact: true }).first().click();
  await mode.filter({ hasText: "A drag on the picture selects." }).waitFor();
  await page.getByRole("button", { name: "Drag a direction" }).click();
  await mode.filter({ hasText: "A drag on the picture informs." }).waitFor();
  await mode.getByRole("button", { name: "Cancel" }).click();
  await hint.waitFor({ state: "hidden" });
  assert.equal(await mode.isVisible(), false);

  await page.getByRole("button", { name: "Drag a direction" }).click();
  const box = (await page.locator("canvas.picture").boundingBox())!;
  await page.mouse.move(box.x + 60, box.y + 250);
  await page.mouse.down();
  await page.mouse.move(box.x + 140, box.y + 170, { steps: 4 });
  await page.keyboard.press("Escape");
  await page.mouse.move(box.x + 200, box.y + 100, { steps: 4 });
  await page.mouse.up();
  assert.equal(await follows(page), "true", "the rest of the drag has no effect");
  await page.waitForTimeout(500);
  assert.deepEqual(await verbs("stop"), []);
  await daemon.command("stop", "delete");
});

test("undo uninforms exactly the individuals that the command informed", async () => {
  await daemon.create("undo", { n: 20, seed: 8 });
  await daemon.command("undo", "inform", { select: { ids: [2, 5] }, direction: 1 });
  const { page } = await openTabOf("undo");
  const words = page.locator(".notices");
  const select = async (ids: string) => {
    await page.getByLabel("ids", { exact: true }).fill(ids);
    await page.getByRole("button", { name: "Select", exact: true }).click();
    await page.getByRole("button", { name: "Drag a direction" }).click();
    await drag(page, PULL);
  };
  await select("5, 7, 11");
  await words.filter({ hasText: "1 of them replacing another direction" }).waitFor();
  assert.deepEqual(await informed("undo"), [2, 5, 7, 11]);
  // Commands of other clients are kept.
  await daemon.command("undo", "inform", { select: { ids: [13] }, direction: 2 });
  await words.getByRole("button", { name: "Undo for 2" }).click();
  await words.filter({ hasText: "undone: 2 individuals uninformed" }).waitFor();
  assert.deepEqual(await informed("undo"), [2, 5, 13]);
  assert.equal(await words.getByRole("button", { name: "Undo" }).count(), 0);

  // If all individuals had a direction there is nothing to undo.
  await select("2, 5");
  await words.filter({ hasText: "2 individuals informed" }).waitFor();
  assert.equal(await words.getByRole("button", { name: "Undo" }).count(), 0);

  // A removed individual is skipped; after a reset the ids belong to other individuals.
  await select("8, 9");
  await words.getByRole("button", { name: "Undo" }).waitFor();
  await daemon.command("undo", "remove", { select: { ids: [8] } });
  await words.getByRole("button", { name: "Undo" }).click();
  await words.filter({ hasText: "undone: 1 individual uninformed" }).waitFor();
  assert.deepEqual(await informed("undo"), [2, 5, 13]);
  // So is one that another client has uninformed.
  await select("6, 7");
  await words.getByRole("button", { name: "Undo" }).waitFor();
  await daemon.command("undo", "uninform", { select: { ids: [7] } });
  await words.getByRole("button", { name: "Undo" }).click();
  await words.filter({ hasText: "undone: 1 individual uninformed" }).waitFor();
  assert.deepEqual(await informed("undo"), [2, 5, 13]);
  await select("6, 7");
  await words.getByRole("button", { name: "Undo" }).waitFor();
  await daemon.command("undo", "uninform", { select: { ids: [6, 7] } });
  await words.getByRole("button", { name: "Undo" }).click();
  await words.filter({ hasText: "none of these individuals has that direction" }).waitFor();
  // An individual that another client has informed again keeps its new direction.
  await select("6, 7");
  await words.getByRole("button", { name: "Undo" }).waitFor();
  await daemon.command("undo", "inform", { select: { ids: [7] }, direction: 3 });
  await words.getByRole("button", { name: "Undo" }).click();
  await words.filter({ hasText: "undone: 1 individual uninformed" }).waitFor();
  assert.deepEqual(await informed("undo"), [2, 5, 7, 13]);
  await select("1, 3");
  await words.getByRole("button", { name: "Undo" }).waitFor();
  await daemon.command("undo", "reset");
  await daemon.command("undo", "inform", { select: { ids: [1] }, direction: 2 });
  await words.getByRole("button", { name: "Undo" }).click();
  await words.filter({ hasText: "none of these individuals has that direction" }).waitFor();
  assert.deepEqual(await informed("undo"), [1]);
  await daemon.command("undo", "delete");
});

/** Runs in the page: the numbers, and the captions of the charts of the same quantities. */
function readBoth(): [string, string][] {
  const text = (element: Element | null | undefined) => element?.textContent ?? "";
  return [...document.querySelectorAll(".chart")].map((chart) => {
    const name = text(chart.querySelector("figcaption b"));
    return [
      text(document.querySelector(`dd[data-number="${name}"]`)),
      text(chart.querySelector("output")),
    ];
  });
}

/** Runs in the page: the share of a picture's pixels that have the colour of a body's inside. */
function shareOf(selector: string): number {
  const canvas = document.querySelector<HTMLCanvasElement>(selector)!;
  const { data } = canvas.getContext("2d")!.getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let k = 0; k < data.length; k += 4) {
    count += data[k] === 0x8f && data[k + 1] === 0xb3 && data[k + 2] === 0xd1 ? 1 : 0;
  }
  return (4 * count) / data.length;
}

test("the bodies of a faulted swarm are hollow, and the picture says why", async () => {
  // Bodies that turn at a touch, in the longest step that is allowed, are turned until two cross.
  await daemon.create("broken", { n: 60, pi4: 1e6, dt: 0.2497, seed: 2 });
  const tab = await openTabOf("broken");
  const { page } = tab;
  const fault = page.locator(".view .fault");
  const label = () => page.locator("canvas.picture").getAttribute("aria-label");
  const share = () => page.evaluate(shareOf, "canvas.picture");
  assert((await share()) > 0.005, `${await share()}`);
  assert.equal(await fault.isVisible(), false);
  tab.expectsError(/^422 POST \/api\/cmd\/broken\/step$/);
  await page.getByLabel("steps", { exact: true }).fill("100");
  await page.getByRole("button", { name: "Step", exact: true }).click();
  await fault.filter({ hasText: "⚠ Faulted at t = 0.50: the last good state" }).waitFor();
  await until("its description", async () =>
    (await label())?.includes("60 individuals, 0 informed, faulted"),
  );
  // Not by colour alone: the inside of the bodies has the colour of the ground.
  await until("hollow bodies", async () => (await share()) === 0);
  await page.locator(".page-head", { hasText: "the bodies of individuals" }).waitFor();

  const list = await openTab();
  await list.page.goto(`${daemon.link}&/`);
  const card = '[data-swarm="broken"]';
  await list.page.locator(`${card} canvas[data-step]`).waitFor();
  assert.equal(await list.page.evaluate(shareOf, `${card} canvas`), 0);

  await daemon.command("broken", "reset");
  await fault.waitFor({ state: "hidden" });
  await until("bodies as before", async () => (await share()) > 0.005);
  await until("a thumbnail as before", async () => {
    return (await list.page.evaluate(shareOf, `${card} canvas`)) > 0;
  });
  await daemon.command("broken", "delete");
});

test("numbers and charts show the same values, paused and running", async () => {
  await daemon.create("both", { n: 30, seed: 8, rate: 20, publish_every: 5 });
  await daemon.command("both", "step", { steps: 300 });
  const page = await open("both");
  const none = page.locator(".chart .none");
  const same = async (when: string) => {
    for (const [value, caption] of await page.evaluate(readBoth)) {
      assert.equal(caption, value, when);
    }
  };
  const drift = page.locator('dd[data-number="drift"]').first();
  await until("a step", async () => (await step(page)) === 300);
  await page.locator(".chart").nth(1).scrollIntoViewIfNeeded();
  await none.filter({ visible: true }).waitFor();
  await same("none informed");

  await daemon.command("both", "inform", { select: { count: 6 }, direction: 2 });
  await until("a drift", async () => /\d/.test((await drift.textContent()) ?? ""));
  await same("informed while paused");
  assert.equal(await none.filter({ visible: true }).count(), 0);
  await daemon.command("both", "step", { steps: 1 });
  await until("a step", async () => (await step(page)) === 301);
  await same("after a step");
  await daemon.command("both", "uninform", { select: { fraction: 1 } });
  await until("no drift", async () => (await drift.textContent()) === "–");
  await same("uninformed while paused");

  await daemon.command("both", "inform", { select: { count: 6 }, direction: 2 });
  await daemon.command("both", "run");
  for (let k = 0; k < 40; k += 1) {
    await same("running");
    await page.waitForTimeout(20);
  }
  assert((await step(page)) > 310);
  await daemon.command("both", "delete");
});

test("f keeps every body completely inside the picture", async () => {
  // A block of bodies and one stray.
  const column = (of: (i: number) => number, stray: number) =>
    Array.from({ length: 30 }, (_, i) => (i === 0 ? stray : of(i)));
  const start = {
    kind: "given",
    x: column((i) => 2 * (i % 6), 70),
    y: column((i) => 2 * Math.floor(i / 6), 3),
    alpha: column(() => 0, 1),
  };
  await daemon.create("stray", { n: 30, seed: 1, rate: 2, publish_every: 5, start });
  const page = await open("stray");
  const box = (await page.locator("canvas.picture").boundingBox())!;
  const whole = ({ axes }: Drawn) => {
    const seen = axes.filter(
      ([a, b, c, d]) =>
        [a, c].every((x) => x > 2 && x < box.width - 2) &&
        [b, d].every((y) => y > 2 && y < box.height - 2),
    );
    return axes.length === 30 && seen.length === 30;
  };
  const last = async () => (await drawn(page)).at(-1)!;
  assert.equal(whole(await last()), false, "by default the stray body is outside");
  await page.keyboard.press("f");
  await until("all bodies", async () => whole(await last()), 3000);
  await daemon.command("stray", "run");
  await page.evaluate("drawn.length = 0");
  await until("many pictures", async () => (await drawn(page)).length >= 30);
  assert((await drawn(page)).every(whole), "also while it runs");
  await daemon.command("stray", "delete");
});
