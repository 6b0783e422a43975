/** The fixture of the browser tests: a daemon with the swarm "school", and tabs on its page. */
import { after, before } from "node:test";
import type { BrowserContextOptions, Page } from "playwright-core";
import { type Tab, tabsOfEachTest } from "./browser.ts";
import { Daemon } from "./daemon.ts";

export interface StateJson {
  step: number;
  id: number[];
  x: number[];
  y: number[];
  weight: number[];
  direction: number[];
}

interface Row {
  swarm: string;
  phase: string;
  step: number;
  n: number;
}

interface Rows {
  result: { swarms: Row[] };
}

export class Site {
  /** Set before the first test of the file. */
  daemon!: Daemon;
  readonly openTab: (options?: BrowserContextOptions) => Promise<Tab> = tabsOfEachTest();

  constructor() {
    before(async () => {
      this.daemon = await Daemon.start();
      await this.daemon.create("school", { n: 40, seed: 3, rate: 5, publish_every: 5 });
    });
    after(() => this.daemon.end());
  }

  async openTabAt(hash: string, token = true, options?: BrowserContextOptions): Promise<Tab> {
    const tab = await this.openTab(options);
    const { link, addresses } = this.daemon;
    await tab.page.goto(token ? `${link}&${hash}` : `${addresses.http}/#${hash}`);
    return tab;
  }

  async open(hash: string, token = true, options?: BrowserContextOptions): Promise<Page> {
    return (await this.openTabAt(hash, token, options)).page;
  }

  async row(name: string): Promise<Row | undefined> {
    const { result } = await this.daemon.get<Rows>("@node/get/swarms");
    return result.swarms.find((it) => it.swarm === name);
  }

  state(name: string): Promise<StateJson> {
    return this.daemon.get<StateJson>(`${name}/state?format=json`);
  }
}

/** The element that shows a number of the swarm. */
export const number = (page: Page, name: string) =>
  page.locator(`dd[data-number="${name}"]`).first();

export const step = async (page: Page) => Number(await number(page, "step").textContent());

/** Presses the pointer at the first place, relative to the box, and drags it over the others. */
export async function drag(
  page: Page,
  box: { x: number; y: number },
  places: readonly (readonly [number, number])[],
  steps = 12,
): Promise<void> {
  const [first, ...rest] = places;
  await page.mouse.move(box.x + first![0], box.y + first![1]);
  await page.mouse.down();
  for (const [x, y] of rest) {
    await page.mouse.move(box.x + x, box.y + y, { steps });
  }
  await page.mouse.up();
}
