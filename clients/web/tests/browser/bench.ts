/** A page behind a slow network, and actions after which it is compared with the daemon. */
import assert from "node:assert/strict";
import type { TestContext } from "node:test";
import type { Page } from "playwright-core";
import { type Tab, until } from "./browser.ts";
import type { Daemon } from "./daemon.ts";
import { Jumble } from "./jumble.ts";
import { differences, recordDrawing } from "./readings.ts";

/** A page of a swarm behind a slow network. */
export interface Bench {
  daemon: Daemon;
  page: Page;
  tab: Tab;
  jumble: Jumble;
  swarm: string;
  /** Sends a command as another client, which nothing delays. */
  send(verb: string, args?: object): Promise<unknown>;
}

export async function openBehind(tab: Tab, daemon: Daemon, swarm: string): Promise<Bench> {
  const { page } = tab;
  page.setDefaultTimeout(20_000);
  await page.addInitScript(recordDrawing);
  const jumble = await Jumble.before(page);
  await page.goto(`${daemon.link}&/swarm/${swarm}`);
  const send = (verb: string, args: object = {}) => daemon.command(swarm, verb, args);
  return { daemon, page, tab, jumble, swarm, send };
}

/** Waits until the page has everything, and is what the daemon has. */
async function agrees({ daemon, page, jumble, swarm }: Bench, after: string): Promise<void> {
  let found: string[] = [];
  await until(
    `the page and the daemon to agree after: ${after}`,
    async () => {
      // The messages and requests of a running swarm do not end.
      const { phase } = await daemon.get<{ phase: string }>(`${swarm}/get/status`);
      const has = () => phase === "running" || jumble.isQuiet;
      if (!has()) {
        return false;
      }
      found = await differences(page, daemon, swarm);
      return found.length === 0 && has();
    },
    20_000,
  ).catch((error: Error) => {
    throw new Error(`${error.message}: ${found.join("; ")}`);
  });
}

export type Action = [name: string, act: (bench: Bench) => Promise<unknown>];

/** Executes the actions one after the other; `agrees` compares the page with the daemon after each. */
export async function actAndCompare(
  t: TestContext,
  bench: Bench,
  actions: Action[],
): Promise<void> {
  const failed: string[] = [];
  for (const [name, act] of actions) {
    const began = Date.now();
    try {
      await act(bench);
      await agrees(bench, name);
    } catch (error) {
      failed.push(`${name}: ${(error as Error).message}`);
      bench.jumble.go();
    }
    t.diagnostic(`${name}: ${Date.now() - began} ms`);
  }
  assert.deepEqual(failed, []);
}
