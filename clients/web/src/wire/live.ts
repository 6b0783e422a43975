/**
 * The page's WebSocket: the list of swarms, and the states and events of the watched swarm.
 *
 * Only the newest state is kept, undecoded, until it is taken. A lost or silent connection is retried
 * with exponential backoff.
 */
import type { OrderSample, SwarmSummary } from "./messages.ts";
import type { LiveText, SwarmEvent } from "./page.ts";
import { currentToken } from "./token.ts";

const MIN_RETRY_MS = 500;
const MAX_RETRY_MS = 4000;
/** The daemon sends a message every second. */
const SILENCE_TIMEOUT_MS = 6000;
/** A missing swarm may be created later: until then the page shows the events of the former one. */
const MISSING_RETRY_MS = 500;

export type Connection = "connecting" | "open" | "lost";

export interface Listener {
  swarms?(rows: SwarmSummary[]): void;
  /** A newer state has arrived; `takeState` returns it. */
  state?(): void;
  order?(message: OrderSample): void;
  event?(event: SwarmEvent): void;
  missed?(count: number): void;
  gone?(): void;
  connection?(connection: Connection): void;
}

export class Live {
  rows: SwarmSummary[] = [];
  connection: Connection = "connecting";

  private readonly listeners = new Set<Listener>();
  private watched: string | null = null;
  private socket: WebSocket | null = null;
  private newest: ArrayBuffer | null = null;
  private pause = MIN_RETRY_MS;
  private retryTimer: ReturnType<typeof setTimeout> | undefined;
  private silence: ReturnType<typeof setTimeout> | undefined;

  listen(listener: Listener): () => void {
    this.listeners.add(listener);
    listener.connection?.(this.connection);
    if (this.rows.length > 0) {
      listener.swarms?.(this.rows);
    }
    return () => this.listeners.delete(listener);
  }

  /** Subscribes to one swarm in addition to the list, or to none. */
  watch(swarm: string | null): void {
    if (swarm === this.watched && this.socket) {
      return;
    }
    this.watched = swarm;
    this.newest = null;
    this.pause = MIN_RETRY_MS;
    this.reconnect();
  }

  /** Removes and returns the newest undecoded state, if there is one. */
  takeState(): ArrayBuffer | null {
    const newest = this.newest;
    this.newest = null;
    return newest;
  }

  /** Connects again, for example to subscribe to another swarm. */
  reconnect(): void {
    clearTimeout(this.retryTimer);
    this.drop();
    if (this.connection === "open") {
      // What is sent until the new one is open is missing, so the listeners request it then.
      this.setConnection("connecting");
    }
    const about = this.watched === null ? "" : `?swarm=${encodeURIComponent(this.watched)}`;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    // A WebSocket request takes no headers, and proxies log URLs: the token is sent as a subprotocol.
    const token = currentToken();
    const protocols = token ? ["jostle", `token.${token}`] : ["jostle"];
    const socket = new WebSocket(`${scheme}://${location.host}/api/ws${about}`, protocols);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => this.receive(data as string | ArrayBuffer);
    socket.onclose = () => this.lose();
    this.socket = socket;
    this.expectMessage();
  }

  /** Closes the socket and ignores further messages. */
  private drop(): void {
    clearTimeout(this.silence);
    if (this.socket) {
      this.socket.onmessage = null;
      this.socket.onclose = null;
      this.socket.close();
      this.socket = null;
    }
  }

  private expectMessage(): void {
    clearTimeout(this.silence);
    this.silence = setTimeout(() => this.lose(), SILENCE_TIMEOUT_MS);
  }

  private lose(): void {
    this.drop();
    this.setConnection("lost");
    this.retry(this.pause);
    this.pause = Math.min(2 * this.pause, MAX_RETRY_MS);
  }

  private retry(pause: number): void {
    clearTimeout(this.retryTimer);
    this.retryTimer = setTimeout(() => this.reconnect(), pause);
  }

  private receive(data: string | ArrayBuffer): void {
    this.expectMessage();
    this.pause = MIN_RETRY_MS;
    this.setConnection("open");
    if (typeof data !== "string") {
      this.newest = data;
      this.notify((listener) => listener.state?.());
      return;
    }
    const text = JSON.parse(data) as LiveText;
    const { swarms, order, event, missed } = text;
    if (swarms) {
      this.rows = swarms;
      this.notify((listener) => listener.swarms?.(swarms));
    }
    if (order) {
      this.notify((listener) => listener.order?.(order));
    }
    if (event) {
      this.notify((listener) => listener.event?.(event));
    }
    if (missed) {
      this.notify((listener) => listener.missed?.(missed));
    }
    if (text.gone) {
      this.drop();
      this.retry(MISSING_RETRY_MS);
      this.notify((listener) => listener.gone?.());
    }
  }

  private setConnection(connection: Connection): void {
    if (connection !== this.connection) {
      this.connection = connection;
      this.notify((listener) => listener.connection?.(connection));
    }
  }

  private notify(what: (listener: Listener) => void): void {
    for (const listener of [...this.listeners]) {
      what(listener);
    }
  }
}
