/**
 * Swarms far from (0, 0), whose positions have another origin: the page shows and does the same as for
 * a twin of the same form about (0, 0).
 */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";
import { differences, picture, recordDrawing, type Segment, type StateJson } from "./readings.ts";
import { drag } from "./site.ts";

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
});

after(() => daemon.end());

/** Multiples of the unit of the origin, so that both twins have the same bits. */
const FAR = [10 * 1024, -3 * 1024] as const;
const TWINS = ["near", "far"] as const;

const state = (name: string) => daemon.get<StateJson>(`${name}/state?format=json`);

async function open(swarm: string): Promise<Page> {
  const { page } = await openTab();
  await page.addInitScript(recordDrawing);
  await page.goto(`${daemon.link}&/swarm/${swarm}`);
  return page;
}

/** Waits until the page is what the daemon has, and does not move. */
async function still(page: Page, swarm: string): Promise<void> {
  let found: string[] = [];
  let scale = 0;
  await until(`the page of ${swarm}`, async () => {
    const before = scale;
    ({ scale } = await picture(page));
    found = scale === before ? await differences(page, daemon, swarm) : ["it moves"];
    return found.length === 0;
  }).catch((error: Error) => assert.deepEqual(found, [], error.message));
}

/** The plane's coordinates of the vertical and the horizontal lines of the grid, and of a corner of the picture. */
function gridOf(
  { segments, scale, size }: Awaited<ReturnType<typeof picture>>,
  { x, y, alpha, origin }: StateJson,
): { right: number[]; up: number[]; bar: number; px: number; edge: [number, number] } {
  const half = (3 / 5) * scale;
  // Any body gives the place of the camera.
  const [c, s] = [half * Math.cos(alpha[0]!), half * Math.sin(alpha[0]!)];
  const long = (it: Segment) => Math.hypot(it[2] - it[0] - 2 * c, it[3] - it[1] + 2 * s) < 0.01;
  const [body] = segments.filter(long);
  assert(body, "the body 0 is drawn");
  const [left, top] = [body[0] + c, body[1] - s];
  const lines = (along: 0 | 1) =>
    segments.filter(
      (it) => it[along] === 0 && it[along + 2] === size[along] && it[1 - along] === it[3 - along],
    );
  return {
    right: lines(1).map((it) => 1024 * origin[0] + x[0]! + (it[0] - left) / scale),
    up: lines(0).map((it) => 1024 * origin[1] + y[0]! - (it[1] - top) / scale),
    // Above the lower left corner.
    bar: Math.max(
      ...segments
        .filter((it) => it[0] < 20 && it[1] === it[3] && Math.abs(size[1] - it[1] - 14) < 1)
        .map((it) => (it[2] - it[0]) / scale),
    ),
    px: 1 / scale,
    edge: [1024 * origin[0] + x[0]! - left / scale, 1024 * origin[1] + y[0]! + top / scale],
  };
}

/** The lines of a grid are at multiples of their distance, and the bar has a round length, up to a pixel. */
function isFixed({ right, up, bar, px }: ReturnType<typeof gridOf>): void {
  const power = 10 ** Math.floor(Math.log10(bar));
  const round = [1, 2, 5, 10].map((it) => it * power);
  assert(
    round.some((it) => Math.abs(it - bar) <= px),
    `${bar} of ${px}`,
  );
  for (const lines of [right, up]) {
    assert(lines.length >= 2, `${lines.length} lines`);
    const apart = Math.abs(lines.at(-1)! - lines[0]!) / (lines.length - 1);
    const power = 10 ** Math.floor(Math.log10(apart * 1.05));
    const spacing = [1, 2, 5, 10].map((it) => it * power).find((it) => it > 0.9 * apart)!;
    for (const at of lines) {
      const off = Math.abs(at - spacing * Math.round(at / spacing));
      assert(
        off <= 1.5 * px,
        `a line at ${at}, with lines ${spacing} apart, is off by ${off / px} px`,
      );
    }
  }
}

test("a swarm far away is shown, followed, selected and informed as one at (0, 0)", async () => {
  const column = (of: (k: number) => number) => Array.from({ length: 16 }, (_, k) => of(k));
  for (const [k, name] of TWINS.entries()) {
    const start = {
      kind: "given",
      x: column((i) => 2.5 * (i % 4) + k * FAR[0]),
      y: column((i) => 2 * Math.floor(i / 4) + k * FAR[1]),
      alpha: column((i) => 0.3 * i),
    };
    await daemon.create(name, { n: 16, seed: 1, start, publish_every: 1000 });
  }
  const pages = { near: await open("near"), far: await open("far") };
  const both = async (act: (page: Page, name: string) => Promise<unknown>) => {
    for (const name of TWINS) {
      await act(pages[name], name);
    }
  };
  const same = async (what: string, exact = true) => {
    await both(still);
    const [near, far] = [await picture(pages.near), await picture(pages.far)];
    assert(Math.abs(far.scale / near.scale - 1) < 1e-6, `${what}: ${far.scale}, not ${near.scale}`);
    isFixed(gridOf(far, await state("far")));
    isFixed(gridOf(near, await state("near")));
    if (exact) {
      // The grid is another one where the unit of the origin is no multiple of its spacing.
      const bodies = (all: Segment[]) =>
        all.filter((it) => it[0] !== it[2] && it[1] !== it[3]).map((it) => it.slice(0, 4));
      const [a, b] = [bodies(near.segments), bodies(far.segments)];
      assert.equal(b.length, a.length, what);
      a.flat().forEach((at, k) => {
        assert(Math.abs(Number(at) - Number(b.flat()[k])) < 1, `${what}: ${at}, ${b.flat()[k]}`);
      });
    }
  };
  const select = async (ids: string) => {
    const selection = async (page: Page) => page.locator(".selection").textContent();
    await both((page) =>
      until(`${ids} to be selected`, async () => (await selection(page))?.endsWith(`: ${ids}`)),
    );
  };
  await same("opened");
  await both((page) => page.keyboard.press("f"));
  await same("fitted");
  // Each state is drawn before the next one, so that both trails have the same points.
  const walk = async (times: number) => {
    for (let k = 0; k < times; k += 1) {
      await both(async (page, name) => {
        await daemon.command(name, "step", { steps: 20 });
        await still(page, name);
      });
    }
  };
  const refit = () => both((page) => page.keyboard.press("f"));
  await both((page) => page.keyboard.press("t"));
  await walk(3);
  await refit();
  await same("after the first steps, which move the origin");
  assert.deepEqual((await state("far")).origin, [10, -3]);
  // A picture that does not follow keeps its place.
  await both(async (page) => {
    for (const key of ["+", "+", "ArrowLeft", "ArrowUp", "k", "c"]) {
      await page.keyboard.press(key);
    }
  });
  await same("zoomed and panned");
  await walk(2);
  await same("with trails");
  await refit();
  await same("followed again");

  // A click at a body, and a lasso around some.
  await both(async (page, name) => {
    const { scale, size } = await picture(page);
    const { x, y } = await state(name);
    const mean = (of: number[]) => of.reduce((sum, it) => sum + it, 0) / of.length;
    const place = (i: number) =>
      [size[0] / 2 + scale * (x[i]! - mean(x)), size[1] / 2 - scale * (y[i]! - mean(y))] as const;
    const box = (await page.locator("canvas.picture").boundingBox())!;
    await page.mouse.click(box.x + place(5)[0], box.y + place(5)[1]);
  });
  await select("5");
  await both(async (page) => {
    await page.keyboard.press("l");
    const box = (await page.locator("canvas.picture").boundingBox())!;
    const [w, h] = [box.width - 70, box.height];
    await drag(page, box, [
      [5, 5],
      [w, 5],
      [w, h - 5],
      [5, h - 5],
      [5, 5],
    ]);
    await drag(page, box, [
      [60, 200],
      [140, 120],
    ]);
  });
  await both((_, name) =>
    until("all informed", async () => (await state(name)).weight.every((it) => it > 0)),
  );
  const [near, far] = [await state("near"), await state("far")];
  assert.deepEqual(far.weight, near.weight);
  await walk(1);
  await refit();
  await same("informed");
});

test("the grid and a picture that does not follow keep their place on a long walk", async () => {
  await daemon.create("walk", { n: 4, seed: 2, rate: 1, publish_every: 5 });
  await daemon.command("walk", "inform", { select: { fraction: 1 }, direction: 0.3 });
  const page = await open("walk");
  const origins = new Set<string>();
  const places: number[] = [];
  await daemon.command("walk", "step", { steps: 33_600 });
  await still(page, "walk");
  // The lines are 10 apart then, which is no divisor of the unit of the origin.
  for (let k = 0; k < 9; k += 1) {
    await page.keyboard.press("-");
  }
  await page.keyboard.press("ArrowLeft");
  let before: [number, number] | null = null;
  for (let k = 0; k < 8; k += 1) {
    await still(page, "walk");
    const now = await state("walk");
    origins.add(String(now.origin));
    const grid = gridOf(await picture(page), now);
    isFixed(grid);
    const [right, up] = before ?? grid.edge;
    assert(Math.hypot(grid.edge[0] - right, grid.edge[1] - up) < 0.1 * grid.px, `${grid.edge}`);
    before = grid.edge;
    places.push(1024 * now.origin[0] + now.x[0]!);
    await daemon.command("walk", "step", { steps: 100 });
  }
  assert.equal(origins.size, 2, `the origin moves once: ${[...origins]}; ${places}`);
});
