/** The list, an animation and a chart of a measure once time has passed, behind a slow network. */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { tabsOfEachTest, until } from "./browser.ts";
import { Daemon } from "./daemon.ts";
import { Jumble } from "./jumble.ts";

const openTab = tabsOfEachTest();
let daemon: Daemon;

before(async () => {
  daemon = await Daemon.start();
});

after(() => daemon.end());

interface Listed {
  swarm: string;
  phase: string;
  step: number;
  time: number;
  n: number;
  informed: number;
  order: number;
}

/** What the list shows of each swarm, without the time of a picture of what runs. */
const listed = (page: Page) =>
  page.evaluate(() =>
    [...document.querySelectorAll<HTMLElement>(".swarm-card")].map((card) => ({
      swarm: card.querySelector("h2")?.textContent,
      phase: card.querySelector<HTMLElement>(".phase")?.dataset.phase,
      order: card.querySelector(".order b")?.textContent,
      facts: [...card.querySelectorAll(".facts span")].slice(0, 3).map((it) => it.textContent),
      drawn: Number(card.querySelector("canvas")?.dataset.step),
    })),
  );

test("the list shows the last state of each swarm, also in its thumbnails", async (t) => {
  await daemon.create("one", { n: 12, seed: 1 });
  await daemon.create("two", { n: 12, seed: 2, rate: 5 });
  const tab = await openTab();
  tab.allowsError(/^404 GET \/api\/get\/two\//);
  const jumble = await Jumble.before(tab.page);
  await tab.page.goto(`${daemon.link}&/`);
  const actions: [string, () => Promise<unknown>][] = [
    ["opened", async () => undefined],
    [
      "steps",
      async () => {
        for (let k = 0; k < 5; k += 1) {
          await daemon.command("one", "step", { steps: 9 });
          await daemon.command("two", "step", { steps: 7 });
        }
      },
    ],
    [
      "informed and injected",
      async () => {
        await daemon.command("one", "inform", { select: { count: 4 }, direction: 1 });
        await daemon.command("two", "inject", { count: 3 });
      },
    ],
    [
      "run and paused",
      async () => {
        await daemon.command("two", "run");
        await tab.page.locator('[data-swarm="two"] [data-phase="running"]').waitFor();
        await daemon.command("two", "pause");
      },
    ],
    ["reset", () => daemon.command("one", "reset")],
    [
      "replaced",
      async () => {
        await daemon.command("two", "delete");
        await daemon.create("two", { n: 5, seed: 7, pi1: 1 });
        await daemon.command("two", "step", { steps: 3 });
      },
    ],
    [
      "another one",
      async () => {
        await daemon.create("three", { n: 3 });
      },
    ],
    ["deleted", () => daemon.command("one", "delete")],
  ];
  for (const [name, act] of actions) {
    const began = Date.now();
    await act();
    let is: unknown;
    let wanted: unknown;
    await until(`the list after: ${name}`, async () => {
      const { result } = await daemon.get<{ result: { swarms: Listed[] } }>("@node/get/swarms");
      wanted = result.swarms.map((it) => ({
        swarm: it.swarm,
        phase: it.phase,
        order: it.order.toFixed(2),
        facts: [`n ${it.n}`, `informed ${it.informed}`, `time ${it.time.toFixed(2)}`],
        drawn: it.step,
      }));
      is = await listed(tab.page);
      return jumble.isSilent && JSON.stringify(is) === JSON.stringify(wanted);
    }).catch(() => assert.deepEqual(is, wanted, name));
    t.diagnostic(`${name}: ${Date.now() - began} ms`);
  }
});

test("the numbers of an animation are those of its last state", async () => {
  await daemon.create("animation-1", { n: 50, seed: 3 });
  const { page } = await openTab();
  const jumble = await Jumble.before(page);
  await page.goto(`${daemon.link}&/gallery/animation-1`);
  const shown = async (of: Page) => of.locator("dd").allTextContents();
  await until("numbers", async () => (await shown(page))[4] === "0.00");
  // Three states at once: none of them is the last that is counted.
  for (const steps of [400, 1, 400]) {
    await daemon.command("animation-1", "step", { steps });
  }
  const { result, time } = await daemon.get<{
    time: number;
    result: { order: { order: number }; certificate: { contacts: number } };
  }>("animation-1/get/status");
  const numbers = [
    result.order.order.toFixed(3),
    "undefined",
    (result.certificate.contacts / 50).toFixed(2),
  ];
  await until("its last time", async () => (await shown(page))[4] === time.toFixed(2));
  await until("quiet", async () => jumble.isQuiet);
  const other = (await openTab()).page;
  await other.goto(`${daemon.link}&/gallery/animation-1`);
  await until("numbers", async () => /%/.test((await shown(other))[3] ?? ""));
  await until(
    "the same numbers",
    async () => {
      const [now, fresh] = [await shown(page), await shown(other)];
      return now.join() === fresh.join() && now.slice(0, 3).join() === numbers.join();
    },
    3000,
  );
});

test("a chart of a measure is drawn although the daemon was busy, or a connection broke", async () => {
  await daemon.create("busy", { n: 12, seed: 1 });
  const tab = await openTab();
  const { page } = tab;
  tab.expectsError(/^503 GET \/api\/get\/busy\/get\/measures/);
  tab.expectsError(/ERR_CONNECTION_RESET \/api\/get\/busy\/get\/measures/);
  let asked = 0;
  await page.route(/measures\?names/, async (route) => {
    asked += 1;
    const error = { code: "busy", message: "busy: wait", details: {}, step: null };
    const fails = [
      () => route.fulfill({ status: 503, json: error }),
      () => route.abort("connectionreset"),
    ];
    await (fails[asked - 1] ?? (() => route.continue()))();
  });
  await page.goto(`${daemon.link}&/swarm/busy`);
  await page.locator(".chart-menu summary").click();
  await page.getByLabel("clusters.count", { exact: true }).check();
  await page.locator(".chart .none", { hasText: "busy: wait" }).waitFor();
  await page.locator(".chart .none", { hasText: "no reply from the daemon" }).waitFor();
  await page.locator(".chart output", { hasText: /^\d+ clusters$/ }).waitFor();
  await page.goto("about:blank");
});
