/** What the daemon sends to the page alone: over HTTP and the WebSocket of `proto/README.md`. */

import type { ErrorBody, EventMessage, Events, OrderSample, SwarmSummary } from "./messages.ts";

/** The swarm that a message is about, and when it was sent. */
export type Stamp = Pick<OrderSample, "swarm" | "epoch" | "step" | "time" | "phase">;

export interface Hello {
  node: string;
  may_watch: boolean;
  may_command: boolean;
  /** The user of the token; null if the daemon has no users. */
  person: string | null;
  role: string | null;
  /** The path of the page token, and whether only root can read it; none if the daemon has users. */
  token_file?: string | null;
  token_needs_root?: boolean | null;
}

/** A value of a parameter that is no number. */
export type Choice = string | { kind: string };

/** An error reply, with the code of any version, or `no_reply` of the page itself. */
export interface Problem extends Omit<ErrorBody, "code" | "details" | "step"> {
  code: string;
  details: Record<string, unknown>;
  step: number | null;
}

/** An event, of a kind that a newer daemon may have added. */
export interface SwarmEvent extends Omit<EventMessage, "event"> {
  event: { kind: string } & Record<string, unknown>;
}

/** The reply to `get/events`. */
export interface EventsPage extends Omit<Events, "events"> {
  events: SwarmEvent[];
}

/** A text message of the WebSocket; each has one of these fields. */
export interface LiveText {
  swarms?: SwarmSummary[];
  order?: OrderSample;
  event?: SwarmEvent;
  missed?: number;
  gone?: boolean;
}
