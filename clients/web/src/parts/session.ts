/** What all pages share: the socket, who the daemon is, and whether this tab may command. */
import { hello, Refused } from "../wire/http.ts";
import { Live } from "../wire/live.ts";
import type { Hello, SwarmRow } from "../wire/messages.ts";
import { currentToken, keepToken } from "../wire/token.ts";

/** Points of a sparkline: one or two a second. */
const REMEMBERED = 240;

/** Matches a path that needs no quoting in a shell. */
const PLAIN = /^[\w./:@%+,-]+$/;

/** The shell command that prints the link to the page at `origin`, with a token. */
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
  /** The order of each swarm in the last lists that this tab received, oldest first. */
  readonly orders = new Map<string, number[]>();
  private readonly listeners = new Set<() => void>();

  constructor() {
    this.live.listen({
      swarms: (rows) => this.remember(rows),
      connection: (connection) => {
        // Who is not known is not let in, which looks like a daemon that is away.
        if (connection !== "connecting") {
          void this.ask();
        }
      },
    });
  }

  get mayCommand(): boolean {
    return this.hello?.may_command ?? false;
  }

  /** Whether this tab may write notes, which controllers may, too. */
  get mayAnnotate(): boolean {
    return this.mayCommand || this.hello?.role === "controller";
  }

  /** Whether the daemon shows itself to this tab; yes, until it says no. */
  get mayWatch(): boolean {
    return this.hello?.may_watch ?? true;
  }

  /** Who this tab is, where the daemon knows people. */
  get person(): string | null {
    return this.hello?.person ?? null;
  }

  /** Whether the daemon knows people, and goes by whose token it is. */
  get knowsPeople(): boolean {
    return this.person !== null || !this.mayWatch;
  }

  /** Why this tab may not command, in a line. */
  get refusal(): string {
    return this.person === null
      ? "this tab has no token, which commands need: the button ○ at the top says how to get one"
      : `you are ${this.person}, ${this.hello?.role}: commanding takes an operator`;
  }

  /** What to type on the daemon's machine to print the link that opens this page with a token. */
  get linkCommand(): string {
    return linkCommand(location.origin, this.hello);
  }

  get hasToken(): boolean {
    return currentToken() !== null;
  }

  /** Calls now, and whenever it is known anew whether this tab may command. */
  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    listener();
    return () => this.listeners.delete(listener);
  }

  async useToken(pasted: string): Promise<boolean> {
    keepToken(pasted);
    await this.ask();
    this.live.look();
    return this.mayCommand || this.person !== null;
  }

  async ask(): Promise<void> {
    try {
      this.hello = await hello();
    } catch (error) {
      if (!(error instanceof Refused)) {
        throw error;
      }
      // The socket says that the daemon is away, and asks again.
    }
    for (const listener of [...this.listeners]) {
      listener();
    }
  }

  private remember(rows: SwarmRow[]): void {
    const there = new Set<string>();
    for (const row of rows) {
      there.add(row.swarm);
      const past = this.orders.get(row.swarm) ?? [];
      past.push(row.order);
      if (past.length > REMEMBERED) {
        past.shift();
      }
      this.orders.set(row.swarm, past);
    }
    for (const name of this.orders.keys()) {
      if (!there.has(name)) {
        this.orders.delete(name);
      }
    }
  }
}
