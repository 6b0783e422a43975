/** What the daemon says, as far as the page reads it. `proto/README.md` is the contract. */

export type Phase = "paused" | "running" | "faulted";

/** The answer to a query or a command about a swarm. */
export interface Reply<T> {
  swarm: string;
  epoch: number;
  step: number;
  time: number;
  phase: Phase;
  seq: number;
  result: T;
}

export interface ErrorBody {
  code: string;
  message: string;
  details: Record<string, unknown>;
  step: number | null;
}

export interface Hello {
  node: string;
  prefix: string;
  version: string;
  may_watch: boolean;
  may_command: boolean;
  /** Who the token is of, where the daemon knows people. */
  person: string | null;
  role: string | null;
  /** Where the page's own token is, and whether it takes root to read it; none with people. */
  token_file?: string | null;
  token_needs_root?: boolean | null;
}

/** A row of `@node/get/swarms`. */
export interface SwarmRow {
  swarm: string;
  phase: Phase;
  reason: string | null;
  step: number;
  time: number;
  n: number;
  informed: number;
  order: number;
  rate: number | null;
  real_time_factor: number | null;
  /** Whether it is the replay of a recording. */
  replay?: boolean;
  /** Another daemon that holds the name; at most one of the two serves it. */
  contested_by?: string | null;
}

/** Where a replay is. */
export interface Replay {
  of: string;
  frame: number;
  frames: number;
  position: number;
  duration: number;
}

export interface OrderNumbers {
  order: number;
  mean_order: number | null;
  velocity: [number, number];
  mean_velocity: [number, number] | null;
  direction: number | null;
  drift: number | null;
  mean_drift: number | null;
}

export interface Certificate {
  worst_gap: number | null;
  residual: number;
  degraded: number;
  crossed: number;
  contacts: number;
  iterations: number;
}

export interface OrderMessage {
  swarm: string;
  epoch: number;
  frame: number;
  step: number;
  time: number;
  phase: Phase;
  n: number;
  informed: number;
  order: OrderNumbers;
  certificate: Certificate;
  rate: number | null;
  real_time_factor: number | null;
}

export type Choice = string | { kind: string };

export interface Parameter {
  name: string;
  doc: string;
  unit: string;
  kind: "integer" | "number" | "choice";
  minimum: number | null;
  exclusive_minimum: number | null;
  maximum: number | null;
  choices: Choice[];
  nullable: boolean;
  default: unknown;
  value: unknown;
  live: boolean;
  changed_by: string[];
}

export interface SwarmEvent {
  swarm: string;
  number: number;
  epoch: number;
  step: number;
  time: number;
  phase: Phase;
  /** The daemon's wall clock, seconds since 1970; older daemons send none. */
  unix_secs?: number | null;
  event: { kind: string } & Record<string, unknown>;
}

export interface EventsResult {
  events: SwarmEvent[];
  oldest: number;
  newest: number;
}

export interface Spec {
  n: number;
  pi1?: number;
  pi2?: number;
  pi3?: number;
  pi4?: number;
  dt?: number;
  seed?: number;
  contacts?: string;
  rate?: number | null;
  publish_every?: number;
}

/** The text messages of the socket; each has one of these fields. */
export interface LiveText {
  swarms?: SwarmRow[];
  order?: OrderMessage;
  event?: SwarmEvent;
  missed?: number;
  gone?: boolean;
}
