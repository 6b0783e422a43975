/**
 * Makes the README's pictures of the page: `JOSTLED=… npm run screenshots [-- FOLDER]`.
 *
 * It starts a daemon with a few seeded swarms: their motion is reproducible, the moment of a picture is not.
 */
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import type { Browser } from "playwright-core";
import { ANIMATIONS } from "./src/pages/animations.ts";
import { launch, openTab, until } from "./tests/browser/browser.ts";
import { Daemon } from "./tests/browser/daemon.ts";

interface Shot {
  file: string;
  hash: string;
  width: number;
  height: number;
  dark?: boolean;
  keys?: string[];
  watching?: boolean;
  /** Whether all animations of the gallery run. */
  animations?: boolean;
  /** The time before the picture is taken, in which charts and trails grow. */
  wait_ms?: number;
}

const SHOTS: Shot[] = [
  {
    file: "page.png",
    hash: "/swarm/school",
    width: 1280,
    height: 800,
    keys: ["k"],
    wait_ms: 12_000,
  },
  {
    file: "page-dark.png",
    hash: "/swarm/school",
    width: 1920,
    height: 1080,
    dark: true,
    keys: ["c", "k", "t"],
    wait_ms: 12_000,
  },
  {
    file: "page-thousand.png",
    hash: "/swarm/thousand",
    width: 1280,
    height: 800,
    dark: true,
    wait_ms: 6000,
  },
  { file: "page-swarms.png", hash: "/", width: 1280, height: 800, wait_ms: 15_000 },
  {
    file: "page-gallery.png",
    hash: "/gallery",
    width: 1280,
    height: 800,
    animations: true,
    wait_ms: 4000,
  },
  {
    file: "page-animation.png",
    hash: "/gallery/animation-1",
    width: 1280,
    height: 800,
    wait_ms: 9000,
  },
  {
    file: "page-phone.png",
    hash: "/swarm/school",
    width: 360,
    height: 740,
    keys: ["t"],
    wait_ms: 6000,
  },
  {
    file: "page-phone-dark.png",
    hash: "/gallery/animation-1",
    width: 360,
    height: 740,
    dark: true,
    watching: true,
    wait_ms: 4000,
  },
];

async function populate(daemon: Daemon): Promise<void> {
  const school = { n: 50, seed: 12, rate: 5, publish_every: 5 };
  await daemon.create("school", school);
  await daemon.command("school", "inform", { select: { count: 10 }, direction: 0.4 });
  await daemon.create("discs", { ...school, pi1: 1 });
  await daemon.create("needles", { ...school, n: 30, pi1: 8 });
  await daemon.create("pair", { ...school, n: 2 });
  await daemon.create("animation-1", { ...school, seed: 5421423068289429 });
  await daemon.command("animation-1", "inform", { select: { count: 10 }, direction: 0 });
  await daemon.create("thousand", { n: 1000, seed: 1, rate: 0.5, publish_every: 2 });
  await daemon.command("thousand", "inform", { select: { fraction: 0.1 }, direction: 1 });
  for (const name of ["school", "discs", "needles", "animation-1"]) {
    await daemon.command(name, "step", { steps: 2500 });
    await daemon.command(name, "run");
  }
  await daemon.command("thousand", "step", { steps: 150 });
  await daemon.command("thousand", "run");
}

/** Creates and runs the animations that do not exist yet. */
async function animate(daemon: Daemon): Promise<void> {
  for (const { swarm, spec, informed } of ANIMATIONS.filter((it) => it.swarm !== "animation-1")) {
    await daemon.create(swarm, spec);
    if (informed > 0) {
      await daemon.command(swarm, "inform", { select: { count: informed }, direction: 0 });
    }
    await daemon.command(swarm, "step", { steps: 1000 });
    await daemon.command(swarm, "run");
  }
}

async function take(browser: Browser, daemon: Daemon, folder: string, shot: Shot): Promise<void> {
  if (shot.animations) {
    await animate(daemon);
  }
  const tab = await openTab(browser, {
    viewport: { width: shot.width, height: shot.height },
    colorScheme: shot.dark ? "dark" : "light",
  });
  const { page } = tab;
  await page.goto(
    shot.watching ? `${daemon.addresses.http}/#${shot.hash}` : `${daemon.link}&${shot.hash}`,
  );
  await page.locator("h1").first().waitFor();
  for (const key of shot.keys ?? []) {
    await page.keyboard.press(key);
  }
  await page.waitForTimeout(shot.wait_ms ?? 1500);
  await until("no errors", async () => tab.errors.length === 0, 1);
  await page.screenshot({ path: join(folder, shot.file) });
  await tab.close();
}

const folder = process.argv[2] ?? join(import.meta.dirname, "../../../docs/pictures");
const only = process.argv[3];
mkdirSync(folder, { recursive: true });
const daemon = await Daemon.start();
const browser = await launch();
try {
  await populate(daemon);
  for (const shot of SHOTS) {
    if (!only || only === shot.file) {
      await take(browser, daemon, folder, shot);
      process.stdout.write(`${shot.file}\n`);
    }
  }
} finally {
  await browser.close();
  await daemon.end();
}
