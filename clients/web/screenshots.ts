/**
 * Makes the pictures of the page in README.md and docs: `JOSTLED=… npm run screenshots [-- FOLDER]`.
 *
 * It starts a daemon with a few seeded swarms: their motion is reproducible, the moment of a picture is not.
 */
import { mkdirSync, mkdtempSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import type { Browser, Page } from "playwright-core";
import { launch, openTab, until } from "./tests/browser/browser.ts";
import { Daemon } from "./tests/browser/daemon.ts";

interface Shot {
  file: string;
  /** A page of the daemon, or what makes a file and returns its address. */
  hash: string | ((daemon: Daemon) => Promise<string>);
  width: number;
  height: number;
  dark?: boolean;
  keys?: string[];
  /** What is done before the picture is taken. */
  act?: (page: Page) => Promise<void>;
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
    wait_ms: 16_000,
  },
  {
    file: "page-dark.png",
    hash: "/swarm/school",
    width: 1440,
    height: 900,
    dark: true,
    keys: ["c", "k", "t"],
    wait_ms: 16_000,
  },
  {
    file: "page-inform.png",
    hash: "/swarm/asked",
    width: 1280,
    height: 800,
    wait_ms: 1500,
    act: drag,
  },
  { file: "page-swarms.png", hash: "/", width: 1280, height: 800, wait_ms: 15_000 },
  {
    file: "page-animation.png",
    hash: "/gallery/animation-1",
    width: 1280,
    height: 800,
    wait_ms: 4000,
  },
  {
    file: "page-phone.png",
    hash: "/swarm/school",
    width: 360,
    height: 740,
    keys: ["t"],
    wait_ms: 16_000,
  },
  {
    file: "page-verify.png",
    hash: "/swarm/asked",
    width: 1280,
    height: 800,
    act: verify,
  },
  { file: "page-file.png", hash: exported, width: 1280, height: 800, wait_ms: 9000 },
];

async function populate(daemon: Daemon): Promise<void> {
  // Slow enough for a busy machine to draw each state.
  const school = { n: 50, seed: 12, rate: 1, publish_every: 5 };
  await daemon.create("school", school);
  await daemon.command("school", "inform", { select: { count: 10 }, direction: 0.4 });
  await daemon.create("discs", { ...school, pi1: 1 });
  await daemon.create("needles", { ...school, n: 30, pi1: 8 });
  await daemon.create("pair", { ...school, n: 2 });
  await daemon.create("animation-1", { ...school, seed: 5421423068289429 });
  await daemon.command("animation-1", "inform", { select: { count: 10 }, direction: 0 });
  await daemon.create("asked", { n: 50, seed: 4 });
  await daemon.create("thousand", { n: 1000, seed: 1, rate: 0.5, publish_every: 2 });
  await daemon.command("thousand", "inform", { select: { fraction: 0.1 }, direction: 1 });
  for (const name of ["school", "discs", "needles", "animation-1"]) {
    await daemon.command(name, "step", { steps: 2500 });
    await daemon.command(name, "run");
  }
  await daemon.command("asked", "inform", { select: { count: 3 }, direction: 2 });
  await daemon.command("asked", "step", { steps: 1500 });
  await daemon.command("thousand", "step", { steps: 150 });
}

/** Selects some individuals with a lasso, and begins to drag a direction. */
async function drag(page: Page): Promise<void> {
  const box = (await page.locator("canvas.picture").boundingBox())!;
  const at = (right: number, down: number, steps = 8) =>
    page.mouse.move(box.x + right * box.width, box.y + down * box.height, { steps });
  await page.keyboard.press("l");
  await at(0.52, 0.1);
  await page.mouse.down();
  for (const [right, down] of [
    [0.85, 0.1],
    [0.85, 0.9],
    [0.52, 0.9],
  ] as const) {
    await at(right, down);
  }
  await page.mouse.up();
  await at(0.2, 0.75);
  await page.mouse.down();
  await at(0.36, 0.5);
}

/** Executes the swarm again, and shows the verdict. */
async function verify(page: Page): Promise<void> {
  await page.getByRole("button", { name: "Verify in your browser" }).click();
  await page.getByText(/^equal after/).waitFor();
}

/** Makes the HTML file of a swarm. */
async function exported(daemon: Daemon): Promise<string> {
  const file = join(mkdtempSync(join(tmpdir(), "jostle-file-")), "asked.html");
  await daemon.jostle("export", "asked", "-o", file);
  return pathToFileURL(file).href;
}

async function take(browser: Browser, daemon: Daemon, folder: string, shot: Shot): Promise<void> {
  const tab = await openTab(browser, {
    viewport: { width: shot.width, height: shot.height },
    colorScheme: shot.dark ? "dark" : "light",
  });
  const { page } = tab;
  const { hash } = shot;
  await page.goto(typeof hash === "string" ? `${daemon.link}&${hash}` : await hash(daemon));
  await page.locator("h1").first().waitFor();
  for (const key of shot.keys ?? []) {
    await page.keyboard.press(key);
  }
  await page.waitForTimeout(shot.wait_ms ?? 1500);
  await shot.act?.(page);
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
