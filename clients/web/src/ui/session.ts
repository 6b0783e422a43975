/** State that all pages share: the WebSocket, the daemon's identity, and this tab's permissions. */
import { hello, RequestError } from "../wire/http.ts";
import { Live } from "../wire/live.ts";
import type { SwarmSummary } from "../wire/messages.ts";
import type { Hello } from "../wire/page.ts";
import { OF_CONTROLLERS } from "../wire/requests.ts";
import { currentToken, keepToken } from "../wire/token.ts";
import { callAll } from "./dom.ts";

/** Points of a sparkline: the daemon sends one or two rows a second, so two to four minutes. */
const MAX_ORDERS = 240;

/** A path that needs no quoting in a shell. */
const PLAIN = /^[\w./:@%+,-]+$/;

/** The shell command that prints the page's link at `origin`, with a token. */
export function linkCommand(origin: string, hello: Hello | null): string {
  const file = hello?.token_file;
  if (!file) {
    return `jostle --credentials FOLDER auth link --page ${origin}`;
  }
  const path = PLAIN.test(file) ? file : `'${file.replaceAll("'", "'\\''")}'`;
  const reads = hello.token_needs_root ? "sudo cat" : "cat";
  return `echo "${origin}/#token=$(${reads} ${path})"`;
}

export class Session {
  readonly live = new Live();
  hello: Hello | null = null;
  /** The order of each swarm in the lists received by this tab, oldest first. */
  readonly orders = new Map<string, number[]>();
  private readonly listeners = new Set<() => void>();
  /** The number of requests for the permissions. */
  private asked = 0;

  constructor() {
    this.live.listen({
      swarms: (rows) => this.recordOrders(rows),
      connection: (connection) => {
        // A WebSocket rejected for its token cannot be distinguished from a lost connection.
        if (connection !== "connecting") {
          void this.refresh();
        }
      },
    });
  }

  get mayCommand(): boolean {
    return this.hello?.may_command ?? false;
  }

  /** Whether this tab may send a command. */
  may(verb: string): boolean {
    const { mayCommand, hello } = this;
    return mayCommand || (hello?.role === "controller" && OF_CONTROLLERS.includes(verb));
  }

  /** Whether this tab may watch; true until `hello` replies otherwise. */
  get mayWatch(): boolean {
    return this.hello?.may_watch ?? true;
  }

  /** The user of this tab's token; null if the daemon has no users. */
  get person(): string | null {
    return this.hello?.person ?? null;
  }

  /** Whether the daemon has users with tokens of their own. */
  get hasUsers(): boolean {
    return this.person !== null || !this.mayWatch;
  }

  /** Why this tab may not send commands, in one line. */
  get refusal(): string {
    return this.person === null
      ? "this tab has no valid token: the button ○ at the top shows how to get one"
      : `you are ${this.person}, ${this.hello?.role}: commands require the role operator`;
  }

  /** The shell command that prints the link to this page, with a token. */
  get linkCommand(): string {
    return linkCommand(location.origin, this.hello);
  }

  get hasToken(): boolean {
    return currentToken() !== null;
  }

  /** Calls the listener now and after each reply to `hello`. */
  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    listener();
    return () => this.listeners.delete(listener);
  }

  async useToken(pasted: string): Promise<boolean> {
    keepToken(pasted);
    await this.refresh();
    this.live.reconnect();
    return this.mayCommand || this.person !== null;
  }

  async refresh(): Promise<void> {
    this.asked += 1;
    const { asked } = this;
    try {
      const reply = await hello();
      if (asked !== this.asked) {
        // The reply to a later request, perhaps with another token, may have overtaken this one.
        return;
      }
      this.hello = reply;
    } catch (error) {
      if (!(error instanceof RequestError)) {
        throw error;
      }
      // The WebSocket reports the lost connection and retries.
    }
    callAll(this.listeners);
  }

  private recordOrders(rows: SwarmSummary[]): void {
    const present = new Set<string>();
    for (const row of rows) {
      present.add(row.swarm);
      const past = this.orders.get(row.swarm) ?? [];
      past.push(row.order);
      if (past.length > MAX_ORDERS) {
        past.shift();
      }
      this.orders.set(row.swarm, past);
    }
    for (const name of this.orders.keys()) {
      if (!present.has(name)) {
        this.orders.delete(name);
      }
    }
  }
}
