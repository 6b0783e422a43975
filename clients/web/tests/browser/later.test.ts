/**
 * The page once time has passed: after each action everything that it shows is what the daemon has,
 * although replies and messages were late, and overtook one another.
 */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { type Action, actAndCompare, openBehind } from "./bench.ts";
import { tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";
import { drag } from "./site.ts";

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
});

after(() => daemon.end());

const button = (page: Page, name: string) => page.getByRole("button", { name, exact: true });
const click = (page: Page, name: string) => button(page, name).click();
const parameter = (page: Page, name: string) =>
  page.locator(".parameter", { has: page.locator(`b:text-is("${name}")`) });
const enter = async (page: Page, label: string, value: string, press: string) => {
  await page.getByLabel(label, { exact: true }).first().fill(value);
  await click(page, press);
};
const setField = async (page: Page, name: string, value: string) => {
  await parameter(page, name).locator("input").first().fill(value);
  await click(page, `set ${name}`);
};
const phaseIs = (swarm: string, phase: string) =>
  until(`${swarm} to be ${phase}`, async () => {
    const { phase: now } = await daemon.get<{ phase: string }>(`${swarm}/get/status`);
    return now === phase;
  });
const isShown = (page: Page, name: string, value: string) =>
  parameter(page, name).locator(".value", { hasText: value }).waitFor();
/** Acts, and holds the replies to commands of the page until `meanwhile` is over. */
const slowly = async (
  page: Page,
  act: () => Promise<unknown>,
  meanwhile: () => Promise<unknown>,
) => {
  let end: () => void = () => undefined;
  const isOver = new Promise<void>((resolve) => {
    end = resolve;
  });
  await page.route("**/api/cmd/**", async (route) => {
    const response = await route.fetch();
    await isOver;
    await route.fulfill({ response });
  });
  const replied = page.waitForResponse(/\/api\/cmd\//);
  await act();
  await meanwhile();
  end();
  await replied;
  await page.unroute("**/api/cmd/**");
};
const box = async (page: Page) => (await page.locator("canvas.picture").boundingBox())!;

/** What one can do to a swarm that is simulated. Each begins where the one before has ended. */
const ACTIONS: Action[] = [
  ["nothing", async () => undefined],
  ["steps of the panel", ({ page }) => enter(page, "steps", "300", "Step")],
  [
    "the key s, three times",
    async ({ page, swarm }) => {
      const stepOf = async () => (await daemon.get<{ step: number }>(`${swarm}/get/status`)).step;
      const before = await stepOf();
      for (let k = 0; k < 3; k += 1) {
        await page.keyboard.press("s");
      }
      // None is rejected because the one before is being executed: the field still has 300.
      await until("all steps", async () => (await stepOf()) === before + 900);
    },
  ],
  [
    "steps of another client, one command at a time",
    async ({ send }) => {
      for (let k = 0; k < 6; k += 1) {
        await send("step", { steps: 7 });
      }
    },
  ],
  ["run", ({ page, swarm }) => click(page, "▶ Run").then(() => phaseIs(swarm, "running"))],
  ["a rate, while it runs", ({ page }) => enter(page, "rate time units / s", "3", "Run at rate")],
  ["a rate of another client", ({ send }) => send("run", { rate: 2 })],
  ["no rate, of another client", ({ send }) => send("run", { rate: null })],
  ["a rate again", ({ page }) => enter(page, "rate time units / s", "2.5", "Run at rate")],
  [
    "no rate",
    async ({ page, swarm }) => {
      await enter(page, "rate time units / s", "", "Run at rate");
      await until("it runs as fast as possible", async () => {
        const status = await daemon.get<{ result: { rate: number | null } }>(`${swarm}/get/status`);
        return status.result.rate === null;
      });
    },
  ],
  ["pause", ({ page, swarm }) => click(page, "❚❚ Pause").then(() => phaseIs(swarm, "paused"))],
  [
    "run and pause, before the page knows that it runs",
    async ({ page, jumble, swarm }) => {
      jumble.hold();
      await page.locator("canvas.picture").focus();
      await page.keyboard.press(" ");
      await page.locator(".notices", { hasText: "running" }).waitFor();
      await page.keyboard.press(" ");
      await phaseIs(swarm, "paused");
      jumble.go();
    },
  ],
  [
    "each number of the parameters",
    async ({ page }) => {
      for (const [name, value] of [
        ["pi2", "0.7"],
        ["pi3", "1.5"],
        ["pi4", "7.5"],
        ["noise", "0.01"],
        ["publish_every", "4"],
      ] as const) {
        await setField(page, name, value);
      }
    },
  ],
  [
    "shorter bodies",
    async ({ page }) => {
      await page.getByLabel("make room").check();
      await setField(page, "pi1", "3.5");
    },
  ],
  [
    "each choice of the parameters",
    async ({ page }) => {
      await parameter(page, "attraction").locator("select").selectOption("metric");
      await click(page, "set attraction");
      await parameter(page, "contacts").locator("select").selectOption("closest");
      await click(page, "set contacts");
    },
  ],
  [
    "a parameter that another client sets twice",
    ({ jumble, send }) =>
      jumble.twice(
        () => send("set", { noise: 0.2 }),
        () => send("set", { noise: 0.4, pi1: 3, make_room: true }),
      ),
  ],
  [
    "a number, set by another client before the reply",
    ({ page, send }) =>
      slowly(
        page,
        () => setField(page, "pi2", "0.45"),
        async () => {
          await isShown(page, "pi2", "0.45");
          await send("set", { pi2: 0.75 });
          await isShown(page, "pi2", "0.75");
        },
      ),
  ],
  [
    "a choice, set by another client before the reply",
    ({ page, send }) =>
      slowly(
        page,
        async () => {
          await parameter(page, "attraction").locator("select").selectOption("voronoi");
          await click(page, "set attraction");
        },
        async () => {
          await isShown(page, "attraction", "voronoi");
          await send("set", { attraction: { kind: "metric", radius: 4 } });
          await isShown(page, "attraction", "metric");
        },
      ),
  ],
  [
    "paused, and run by another client before the reply",
    async ({ page, send, swarm }) => {
      await send("run", { rate: 2 });
      await button(page, "❚❚ Pause").waitFor();
      await slowly(
        page,
        () => click(page, "❚❚ Pause"),
        async () => {
          await phaseIs(swarm, "paused");
          await button(page, "▶ Run").waitFor();
          await send("run", { rate: 2 });
          await button(page, "❚❚ Pause").waitFor();
          // Some steps later than the reply.
          await new Promise((resolve) => setTimeout(resolve, 500));
        },
      );
      // Sooner than the page doubts a reply.
      await new Promise((resolve) => setTimeout(resolve, 200));
      assert.equal(await button(page, "❚❚ Pause").count(), 1);
      await send("pause");
    },
  ],
  [
    "a number that the daemon rejects",
    async ({ page, tab, send }) => {
      tab.expectsError(/^4\d\d POST \/api\/cmd\/later\/set$/);
      await parameter(page, "relinearise").locator("input").fill("1");
      await send("set", { stepping: "velocity" });
      await click(page, "set relinearise");
      await page.locator(".errors p").waitFor();
      assert.equal(await parameter(page, "relinearise").locator("input").inputValue(), "1");
      await page.locator("canvas.picture").focus();
      await send("set", { stepping: "position" });
    },
  ],
  [
    "all measures in charts",
    async ({ page, send }) => {
      await page.locator(".chart-menu summary").click();
      for (const name of ["clusters.largest", "milling", "radius_of_gyration"]) {
        await page.getByLabel(name, { exact: true }).check();
      }
      await send("step", { steps: 200 });
      await send("step", { steps: 200 });
    },
  ],
  [
    "informed in the form",
    async ({ page }) => {
      await enter(page, "ids", "1, 2, 3", "Select");
      await page.locator(".steering").getByLabel("direction").fill("90");
      await click(page, "Inform");
      await page.locator(".notices", { hasText: "3 individuals informed" }).waitFor();
    },
  ],
  [
    "undone",
    async ({ page }) => {
      await click(page, "Undo");
      await page.locator(".notices", { hasText: "undone" }).waitFor();
    },
  ],
  [
    "informed by a drag",
    async ({ page, swarm }) => {
      await click(page, "Select all");
      await click(page, "Drag a direction");
      await drag(page, await box(page), [
        [60, 250],
        [140, 170],
      ]);
      await until("all informed", async () => {
        const { result } = await daemon.get<{ result: { informed: number } }>(
          `${swarm}/get/status`,
        );
        return result.informed === 24;
      });
    },
  ],
  ["uninformed", ({ page }) => click(page, "Uninform")],
  [
    "informed and uninformed by another client",
    async ({ send }) => {
      await send("inform", { select: { count: 5 }, direction: 1 });
      await send("uninform", { select: { informed: true } });
      await send("inform", { select: { count: 3 }, direction: 2 });
    },
  ],
  ["injected", ({ page }) => enter(page, "individuals to inject", "2", "Inject")],
  [
    "the selected removed by another client",
    async ({ page, send }) => {
      await enter(page, "ids", "4, 5, 6", "Select");
      await send("remove", { select: { ids: [4, 6] } });
      await page.locator(".selection", { hasText: /^1 individual selected: 5$/ }).waitFor();
    },
  ],
  [
    "conditions added, fired and removed",
    async ({ page, send }) => {
      for (const condition of ["order > 0.9999 for 70", "order >= 0", "drift > 0.9999 for 50"]) {
        await page.getByLabel("condition", { exact: true }).fill(condition);
        await click(page, "Add condition");
        await page.locator(".waiting", { hasText: condition }).waitFor();
        await page.locator(".conditions form:not([aria-busy])").waitFor();
      }
      await send("step", { steps: 1 });
      await click(page, "remove the condition drift > 0.9999 for 50");
    },
  ],
  [
    "conditions of another client",
    async ({ jumble, send }) => {
      await jumble.twice(
        () => send("when", { condition: "order > 0.998 for 20", pause: true }),
        () => send("when", { condition: "order > 0.997 for 20", pause: true }),
      );
      await jumble.twice(
        () => send("annotate", { text: "two wait" }),
        () => send("when", { condition: "order > 0.999 for 20", pause: true }),
      );
    },
  ],
  [
    "conditions removed by another client",
    async ({ send }) => {
      await send("when", { cancel: true });
    },
  ],
  ["a note", ({ page }) => enter(page, "note in the journal", "seen", "Add note")],
  [
    "zoomed, panned and followed, with all layers",
    async ({ page, send }) => {
      for (const key of ["c", "k", "t", "p", "+", "ArrowLeft", "ArrowUp"]) {
        await page.keyboard.press(key);
      }
      await send("step", { steps: 100 });
    },
  ],
  [
    "followed again",
    async ({ page, send }) => {
      for (const key of ["f", "c", "k", "t", "p"]) {
        await page.keyboard.press(key);
      }
      await send("step", { steps: 100 });
    },
  ],
  [
    "a lost connection, meanwhile changed by another client",
    async ({ page, jumble, send }) => {
      await jumble.lose();
      await page.getByText("No connection to the daemon, reconnecting").first().waitFor();
      await send("set", { pi2: 0.9 });
      await send("when", { condition: "order > 0.996 for 20", pause: true });
      await send("step", { steps: 20 });
      jumble.mend();
    },
  ],
  [
    "a name that another swarm has got meanwhile",
    async ({ page, jumble, send, swarm }) => {
      await click(page, "Select all");
      await jumble.lose();
      await page.getByText("No connection to the daemon, reconnecting").first().waitFor();
      await send("delete");
      await daemon.create(swarm, { n: 24, seed: 9, publish_every: 2 });
      for (let k = 0; k < 40; k += 1) {
        await send("annotate", { text: `note ${k}` });
      }
      await send("step", { steps: 3000 });
      jumble.mend();
      await page.locator(".selection", { hasText: /^No individual is selected/ }).waitFor();
    },
  ],
  [
    "reset in the dialog",
    async ({ page }) => {
      await click(page, "Reset …");
      await page.locator("dialog").getByRole("button", { name: "Reset", exact: true }).click();
      await page.locator(".notices", { hasText: "reset to step 0" }).waitFor();
    },
  ],
  [
    "deleted, and created as another swarm, which takes fewer steps",
    async ({ page, send, swarm }) => {
      await send("step", { steps: 500 });
      await send("delete");
      await page.getByText(`No swarm ${swarm}`).waitFor();
      await daemon.create(swarm, { n: 24, seed: 5, pi1: 3 });
      await send("step", { steps: 100 });
    },
  ],
  [
    "another page and back, changed before the first message",
    async ({ page, jumble, send, swarm }) => {
      await page.evaluate('location.hash = "#/"');
      await page.locator(`[data-swarm="${swarm}"]`).waitFor();
      jumble.hold();
      await page.locator(`[data-swarm="${swarm}"]`).click();
      await page.locator("h1", { hasText: swarm }).waitFor();
      await until("quiet", async () => jumble.isSilent);
      await send("set", { pi3: 2.5 });
      jumble.go();
    },
  ],
  [
    "the daemon killed and started again",
    async ({ page, tab, send }) => {
      // It rejects requests and WebSockets until it has recovered its swarms.
      tab.allowsError(/^429 GET \/api\/get\/later\//);
      tab.allowsError(
        /^WebSocket connection to \S+ failed: .*(code: 429|net::ERR_CONNECTION_REFUSED)$/,
      );
      tab.allowsError(/net::ERR_(CONNECTION_REFUSED|CONNECTION_RESET|EMPTY_RESPONSE|FAILED)/);
      await send("inform", { select: { count: 4 }, direction: 1 });
      await daemon.kill();
      await page.getByText("No connection to the daemon, reconnecting").first().waitFor();
      await daemon.restart();
      await send("step", { steps: 30 });
    },
  ],
  ["opened again, with events of before the restart", ({ page }) => page.reload()],
];

test("after each action, once all replies are there, the page is as the daemon is", async (t) => {
  await daemon.create("later", { n: 24, seed: 3, rate: 2, publish_every: 5 });
  const bench = await openBehind(await openTab(), daemon, "later");
  // The second of two steps may come while the first is executed; a request may be under way when its
  // swarm is deleted.
  bench.tab.allowsError(/^409 POST \/api\/cmd\/later\/step$/);
  bench.tab.allowsError(/^404 GET \/api\/get\/later\//);
  await actAndCompare(t, bench, ACTIONS);
  await bench.page.goto("about:blank");
  await daemon.command("later", "delete");
});

const slider = (page: Page) => page.getByRole("slider", { name: "position in the recording" });
const value = async (page: Page) => Number(await slider(page).inputValue());
/** Presses the pointer on the slider at a share of its width, and drags it over others. */
const press = async (page: Page, ...shares: number[]) => {
  const { x, y, width, height } = (await slider(page).boundingBox())!;
  for (const [k, share] of shares.entries()) {
    await page.mouse.move(x + share * width, y + height / 2, { steps: 3 });
    if (k === 0) {
      await page.mouse.down();
    }
  }
};

/** What one can do to a playback. */
const SEEKS: Action[] = [
  ["opened", ({ page }) => slider(page).waitFor()],
  [
    "dragged away and back",
    async ({ page, send }) => {
      await press(page, 0, 0.4, -0.2);
      await page.mouse.up();
      await send("seek", { fraction: 0.5 });
    },
  ],
  [
    "another client, while it is dragged",
    async ({ page, send }) => {
      await press(page, 0.5, 0.7);
      const at = await value(page);
      await send("seek", { fraction: 0.1 });
      await page.locator(".events", { hasText: "fraction 0.1" }).waitFor();
      assert.equal(await value(page), at);
      await page.mouse.up();
      await until("its position", async () => Math.abs((await value(page)) - at) < 20);
    },
  ],
  [
    "the keys End, Home and End",
    async ({ page }) => {
      await slider(page).focus();
      for (const key of ["End", "Home", "End"]) {
        await page.keyboard.press(key);
      }
    },
  ],
  [
    "another client, twice",
    ({ jumble, send }) =>
      jumble.twice(
        () => send("seek", { fraction: 0.3 }),
        () => send("seek", { fraction: 0.2 }),
      ),
  ],
  ["run slowly by another client", ({ send }) => send("run", { rate: 0.2 })],
  [
    "dragged while it runs",
    async ({ page, swarm }) => {
      await press(page, 0.1, 0.05);
      const at = await value(page);
      const { step } = await daemon.get<{ step: number }>(`${swarm}/get/status`);
      await until("later steps", async () => {
        const number = page.locator('dd[data-number="step"]').first();
        return Number(await number.textContent()) > step + 5;
      });
      assert.equal(await value(page), at);
      await page.mouse.up();
    },
  ],
  ["paused", ({ page }) => click(page, "❚❚ Pause")],
  [
    "a lost connection, meanwhile another client",
    async ({ page, jumble, send }) => {
      await jumble.lose();
      await page.getByText("No connection to the daemon, reconnecting").first().waitFor();
      await send("seek", { fraction: 0.8 });
      jumble.mend();
    },
  ],
];

test("the slider of a playback follows the daemon again, and not while it is moved", async (t) => {
  await daemon.create("filmed", { n: 10, seed: 4, rate: 20, publish_every: 1 });
  const recorded = daemon.jostle("record", "filmed", "-o", "film.mcap", "--steps", "400");
  await daemon.command("filmed", "run");
  await recorded;
  await daemon.command("filmed", "delete");
  await daemon.jostle("replay", "film.mcap", "--as", "film", "--paused");
  const bench = await openBehind(await openTab(), daemon, "film");
  await actAndCompare(t, bench, SEEKS);
});
