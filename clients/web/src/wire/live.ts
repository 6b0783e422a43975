/**
 * The page's one WebSocket: what the daemon tells of all swarms and of the one that is watched.
 *
 * Of states that come faster than they are taken only the newest is kept, undecoded. A connection
 * that ends is made again, with a pause that grows; so is one without a sign of life.
 */
import type { LiveText, OrderMessage, SwarmEvent, SwarmRow } from "./messages.ts";
import { currentToken } from "./token.ts";

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 4000;
/** The daemon says something every second. */
const SILENCE_MS = 6000;
/** A swarm that is not there may be created by somebody. */
const GONE_PAUSE_MS = 2000;

export type Connection = "connecting" | "here" | "away";

export interface Listener {
  swarms?(rows: SwarmRow[]): void;
  /** A newer state is there: `takeState` has it. */
  state?(): void;
  order?(message: OrderMessage): void;
  event?(event: SwarmEvent): void;
  missed?(count: number): void;
  gone?(): void;
  connection?(connection: Connection): void;
}

export class Live {
  rows: SwarmRow[] = [];
  connection: Connection = "connecting";

  private readonly listeners = new Set<Listener>();
  private watched: string | null = null;
  private socket: WebSocket | null = null;
  private newest: ArrayBuffer | null = null;
  private pause = FIRST_PAUSE_MS;
  private again: ReturnType<typeof setTimeout> | undefined;
  private silence: ReturnType<typeof setTimeout> | undefined;

  listen(listener: Listener): () => void {
    this.listeners.add(listener);
    listener.connection?.(this.connection);
    if (this.rows.length > 0) {
      listener.swarms?.(this.rows);
    }
    return () => this.listeners.delete(listener);
  }

  /** Watches one swarm beside the list of all, or none. */
  watch(swarm: string | null): void {
    if (swarm === this.watched && this.socket) {
      return;
    }
    this.watched = swarm;
    this.newest = null;
    this.pause = FIRST_PAUSE_MS;
    this.connect();
  }

  /** Asks again for a swarm that was gone, since somebody made it. */
  look(): void {
    this.connect();
  }

  /** The newest state that was not taken yet, as it came. */
  takeState(): ArrayBuffer | null {
    const newest = this.newest;
    this.newest = null;
    return newest;
  }

  private connect(): void {
    clearTimeout(this.again);
    this.drop();
    const about = this.watched === null ? "" : `?swarm=${encodeURIComponent(this.watched)}`;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    // A socket takes no header, and a token in its address would be written down on the way.
    const token = currentToken();
    const protocols = token ? ["jostle", `token.${token}`] : ["jostle"];
    const socket = new WebSocket(`${scheme}://${location.host}/api/ws${about}`, protocols);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => this.hear(data as string | ArrayBuffer);
    socket.onclose = () => this.lose();
    this.socket = socket;
    this.expectWord();
  }

  /** Lets go of the socket without another word from it. */
  private drop(): void {
    clearTimeout(this.silence);
    if (this.socket) {
      this.socket.onmessage = null;
      this.socket.onclose = null;
      this.socket.close();
      this.socket = null;
    }
  }

  private expectWord(): void {
    clearTimeout(this.silence);
    this.silence = setTimeout(() => this.lose(), SILENCE_MS);
  }

  private lose(): void {
    this.drop();
    this.say("away");
    this.retry(this.pause);
    this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
  }

  private retry(pause: number): void {
    clearTimeout(this.again);
    this.again = setTimeout(() => this.connect(), pause);
  }

  private hear(data: string | ArrayBuffer): void {
    this.expectWord();
    this.pause = FIRST_PAUSE_MS;
    this.say("here");
    if (typeof data !== "string") {
      this.newest = data;
      this.tell((listener) => listener.state?.());
      return;
    }
    const text = JSON.parse(data) as LiveText;
    const { swarms, order, event, missed } = text;
    if (swarms) {
      this.rows = swarms;
      this.tell((listener) => listener.swarms?.(swarms));
    }
    if (order) {
      this.tell((listener) => listener.order?.(order));
    }
    if (event) {
      this.tell((listener) => listener.event?.(event));
    }
    if (missed) {
      this.tell((listener) => listener.missed?.(missed));
    }
    if (text.gone) {
      this.drop();
      this.retry(GONE_PAUSE_MS);
      this.tell((listener) => listener.gone?.());
    }
  }

  private say(connection: Connection): void {
    if (connection !== this.connection) {
      this.connection = connection;
      this.tell((listener) => listener.connection?.(connection));
    }
  }

  private tell(what: (listener: Listener) => void): void {
    for (const listener of [...this.listeners]) {
      what(listener);
    }
  }
}
