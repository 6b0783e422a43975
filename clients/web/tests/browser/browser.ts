/** Chromium without a GPU, and what it complains of. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { extname, join } from "node:path";
import { after, afterEach, before } from "node:test";
import { type Browser, type BrowserContextOptions, chromium, type Page } from "playwright-core";

const ARGS = [
  "--headless",
  "--no-sandbox",
  "--disable-gpu",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];

/** A document that a test brings along counts as one from afar, which may not ask this machine. */
const BROUGHT = process.env.PAGE_DIST ? ["--disable-features=LocalNetworkAccessChecks"] : [];

export function launch(): Promise<Browser> {
  const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
  return chromium.launch({ executablePath, args: [...ARGS, ...BROUGHT] });
}

export interface Tab {
  page: Page;
  /** What the console called an error; refusals, and a daemon that is away, are none. */
  complaints: string[];
  close(): Promise<void>;
}

const WIDE: BrowserContextOptions = { viewport: { width: 1280, height: 800 } };

export async function openTab(browser: Browser, options = WIDE): Promise<Tab> {
  const context = await browser.newContext(options);
  await serveFrom(process.env.PAGE_DIST, context);
  const page = await context.newPage();
  const complaints: string[] = [];
  page.on("console", (message) => {
    const text = message.text();
    const expected =
      /ERR_CONNECTION_(REFUSED|RESET)|ERR_EMPTY_RESPONSE|WebSocket connection to|status of 4\d\d/.test(
        text,
      );
    if (message.type() === "error" && !expected) {
      complaints.push(text);
    }
  });
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) => {
      console.error(`violation of ${event.violatedDirective}: ${event.blockedURI}`);
    });
  });
  return { page, complaints, close: () => context.close() };
}

/** A browser for the tests of a file. Returns what opens a tab in it; it is closed after its test, in
 * which nothing may have been complained of. */
export function tabsOfEachTest(): (options?: BrowserContextOptions) => Promise<Tab> {
  let browser: Browser;
  const tabs: Tab[] = [];
  before(async () => {
    browser = await launch();
  });
  afterEach(async () => {
    for (const tab of tabs.splice(0)) {
      const { complaints } = tab;
      await tab.close();
      assert.deepEqual(complaints, []);
    }
  });
  after(() => browser.close());
  return async (options) => {
    const tab = await openTab(browser, options);
    tabs.push(tab);
    return tab;
  };
}

/** Serves a newer build than the one inside the daemon, under the daemon's policy. */
async function serveFrom(
  dist: string | undefined,
  context: { route: Page["route"] },
): Promise<void> {
  if (!dist) {
    return;
  }
  const kinds: Record<string, string> = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
  };
  await context.route(/^http:\/\/127\.0\.0\.1:\d+\/(?!api\/)[^/]*$/, (route) => {
    const path = new URL(route.request().url()).pathname;
    const file = path === "/" ? "/index.html" : path;
    return route.fulfill({
      body: readFileSync(join(dist, file)),
      contentType: kinds[extname(file)] ?? "application/octet-stream",
      headers: { "Content-Security-Policy": "default-src 'self'" },
    });
  });
}

/** Waits for something, with a deadline. */
export async function until<T>(
  what: string,
  ask: () => Promise<T | null | undefined | false>,
  timeout_ms = 15_000,
): Promise<T> {
  const ends = Date.now() + timeout_ms;
  for (;;) {
    const found = await ask();
    if (found) {
      return found;
    }
    assert(Date.now() < ends, `waited in vain for ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}
