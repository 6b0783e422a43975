/** Launches Chromium without a GPU, and records the errors of its pages. */
import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { extname, join } from "node:path";
import { after, afterEach, before } from "node:test";
import {
  type Browser,
  type BrowserContext,
  type BrowserContextOptions,
  chromium,
  type Page,
} from "playwright-core";

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

/** Chromium treats a document from `route.fulfill` as remote, and blocks its requests to loopback. */
const LOCAL_PAGE = process.env.PAGE_DIST ? ["--disable-features=LocalNetworkAccessChecks"] : [];

export function launch(): Promise<Browser> {
  const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
  assert(
    existsSync(executablePath),
    `no chromium at ${executablePath}: apt-get install chromium, or set CHROMIUM`,
  );
  return chromium.launch({ executablePath, args: [...ARGS, ...LOCAL_PAGE] });
}

/** An error that a test expects, and how often. */
interface Expected {
  pattern: RegExp;
  least: number;
  most: number;
}

export class Tab {
  /** Errors of the console and of scripts, and replies with a status of 400 or more. */
  readonly errors: string[] = [];
  private readonly expected: Expected[] = [];

  constructor(
    readonly page: Page,
    private readonly context: BrowserContext,
  ) {
    page.on("console", (message) => {
      if (message.type() === "error") {
        this.takeConsole(message.text(), message.location().url);
      }
    });
    page.on("response", (response) => {
      const method = response.request().method();
      // A daemon without an engine says so.
      const isAsked = method === "HEAD" && response.url().endsWith("/jostle.wasm");
      if (response.status() >= 400 && !isAsked) {
        this.errors.push(`${response.status()} ${method} ${pathOf(response.url())}`);
      }
    });
    page.on("pageerror", (error) => this.errors.push(String(error)));
  }

  /** Declares an error that must occur, at least once and at most `most` times. */
  expectsError(pattern: RegExp, most = 1): void {
    this.expected.push({ pattern, least: 1, most });
  }

  /** Declares an error that may occur, depending on timing. */
  allowsError(pattern: RegExp): void {
    this.expected.push({ pattern, least: 0, most: Number.POSITIVE_INFINITY });
  }

  /** Closes the tab. Fails if there was an error that the test did not declare, or a declared one
   * did not occur as often as declared. */
  async close(): Promise<void> {
    await this.context.close();
    const others = this.errors.filter(
      (it) => !this.expected.some(({ pattern }) => pattern.test(it)),
    );
    assert.deepEqual(others, [], "errors that the test does not expect");
    for (const { pattern, least, most } of this.expected) {
      const count = this.errors.filter((it) => pattern.test(it)).length;
      const bounds = `expected ${least} to ${most} errors ${pattern}`;
      assert(least <= count && count <= most, `${bounds}, got ${count}`);
    }
  }

  private takeConsole(text: string, url: string): void {
    if (/the server responded with a status of/.test(text)) {
      // The response itself is recorded, with its method and path.
      return;
    }
    const resource = /^Failed to load resource/.test(text) ? ` ${pathOf(url)}` : "";
    this.errors.push(text + resource);
  }
}

function pathOf(url: string): string {
  const { pathname, search } = new URL(url);
  return pathname + search;
}

const WIDE: BrowserContextOptions = { viewport: { width: 1280, height: 800 } };

export async function openTab(browser: Browser, options = WIDE): Promise<Tab> {
  const context = await browser.newContext(options);
  await serveFrom(process.env.PAGE_DIST, context);
  const tab = new Tab(await context.newPage(), context);
  await tab.page.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) => {
      console.error(
        `content security policy violated: ${event.violatedDirective}: ${event.blockedURI}`,
      );
    });
  });
  return tab;
}

/** Launches a browser for the tests of a file. Returns a function that opens a tab until its test ends. */
export function tabsOfEachTest(): (options?: BrowserContextOptions) => Promise<Tab> {
  let browser: Browser;
  const tabs: Tab[] = [];
  before(async () => {
    browser = await launch();
  });
  afterEach(async () => {
    const closed = await Promise.allSettled(tabs.splice(0).map((tab) => tab.close()));
    const failed = closed.find((it) => it.status === "rejected");
    if (failed) {
      throw failed.reason;
    }
  });
  after(() => browser.close());
  return async (options) => {
    const tab = await openTab(browser, options);
    tabs.push(tab);
    return tab;
  };
}

/** Serves the page from a folder instead of the daemon's binary, with the daemon's policy. */
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
  await context.route(/^http:\/\/127\.0\.0\.1:\d+\/(?!api\/|jostle\.wasm)[^/]*$/, (route) => {
    const path = new URL(route.request().url()).pathname;
    const file = path === "/" ? "/index.html" : path;
    return route.fulfill({
      body: readFileSync(join(dist, file)),
      contentType: kinds[extname(file)] ?? "application/octet-stream",
      headers: {
        "Content-Security-Policy": "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'",
      },
    });
  });
}

/** Polls until the result is truthy; fails after the timeout. */
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
    assert(Date.now() < ends, `timed out waiting for ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}
