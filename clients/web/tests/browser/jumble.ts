/**
 * A slow network between a page and its daemon: replies are held for different times, so that later
 * ones overtake, and the messages of the WebSocket are late, in their order.
 */
import type { Page, Request, Route, WebSocketRoute } from "playwright-core";

/** The time for which a reply is held. If the same was requested again until then, that reply overtakes. */
const REPLY_MS = 250;
/** The time for which each message of the WebSocket is held. */
const MESSAGE_MS = 80;

const wait = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));

/** The kind of a request: its path without parameters. */
const kindOf = (request: Request) => new URL(request.url()).pathname;

export class Jumble {
  /** Replies that the page has not received yet. */
  private held = 0;
  /** The number of replies that the daemon has sent. */
  private replied = 0;
  /** Of each kind the newest request, until the page has its reply. */
  private readonly newest = new Map<string, { request: Request; passed: Promise<void> }>();
  private readonly sockets = new Set<WebSocketRoute>();
  private cut = false;
  private stopped: Promise<void> | null = null;
  private resume: () => void = () => undefined;
  private queued = 0;

  /** Puts it between the page and the daemon; before the page is opened. */
  static async before(page: Page): Promise<Jumble> {
    const jumble = new Jumble();
    await page.route(/\/api\/(get|cmd|node)\//, async (route) => {
      jumble.held += 1;
      const request = route.request();
      const passed = jumble.pass(route).catch(() => undefined);
      jumble.newest.set(kindOf(request), { request, passed });
      await passed;
      jumble.held -= 1;
    });
    await page.routeWebSocket(/\/api\/ws/, (socket) => jumble.forward(socket));
    return jumble;
  }

  /** Passes a request on, and holds its reply. */
  private async pass(route: Route): Promise<void> {
    try {
      const response = await route.fetch();
      this.replied += 1;
      await wait(REPLY_MS);
      const newest = this.newest.get(kindOf(route.request()));
      if (newest && newest.request !== route.request()) {
        await newest.passed;
      }
      await route.fulfill({ response });
    } catch {
      // The daemon is gone, or the page.
      await route.abort("connectionrefused");
    }
  }

  /** Acts twice: the second time as soon as the daemon has replied to a request that the first caused, and
   * before the page has this reply. */
  async twice(first: () => Promise<unknown>, second: () => Promise<unknown>): Promise<void> {
    const { replied } = this;
    await first();
    while (this.replied === replied) {
      await wait(5);
    }
    await second();
  }

  /** Whether the page has everything that the daemon has sent. */
  get isQuiet(): boolean {
    return this.held === 0 && this.queued === 0;
  }

  /** Whether the page has all replies, though perhaps not the messages that are held. */
  get isSilent(): boolean {
    return this.held === 0;
  }

  /** Holds all further messages of the WebSocket, and new ones before they are connected, until `go`. */
  hold(): void {
    this.stopped ??= new Promise((resolve) => {
      this.resume = resolve;
    });
  }

  go(): void {
    this.resume();
    this.stopped = null;
  }

  /** Closes the page's WebSockets, and rejects new ones until `mend`. */
  async lose(): Promise<void> {
    this.cut = true;
    await Promise.all([...this.sockets].map((it) => it.close({ code: 1001 })));
    this.sockets.clear();
  }

  mend(): void {
    this.cut = false;
  }

  private async forward(socket: WebSocketRoute): Promise<void> {
    await this.stopped;
    if (this.cut) {
      void socket.close({ code: 1001 });
      return;
    }
    const server = socket.connectToServer();
    this.sockets.add(socket);
    let before: Promise<unknown> = Promise.resolve();
    server.onMessage((message) => {
      this.queued += 1;
      const late = wait(MESSAGE_MS);
      before = before
        .then(() => Promise.all([late, this.stopped]))
        .then(() => {
          if (this.sockets.has(socket)) {
            socket.send(message);
          }
        })
        .catch(() => undefined)
        .finally(() => {
          this.queued -= 1;
        });
    });
    // After the messages before it.
    server.onClose((code, reason) => {
      before = before.then(() => {
        this.sockets.delete(socket);
        return socket.close({ ...(code === undefined ? {} : { code }), reason: reason ?? "" });
      });
    });
  }
}
