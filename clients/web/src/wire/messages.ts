/** The daemon's messages, as far as the page reads them; specified in `proto/README.md`. */

export type Phase = "paused" | "running" | "faulted";

/** The swarm that a message is about, and when it was sent. */
export interface Stamp {
  swarm: string;
  epoch: number;
  step: number;
  time: number;
  phase: Phase;
}

/** The reply to a query or a command of a swarm. */
export interface Reply<T> extends Stamp {
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
  may_watch: boolean;
  may_command: boolean;
  /** The user of the token; null if the daemon has no users. */
  person: string | null;
  role: string | null;
  /** The path of the page token, and whether only root can read it; none if the daemon has users. */
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
  /** Whether the swarm is a playback of a recording. */
  replay?: boolean;
  /** Another daemon that claims the name; at most one of the two serves it. */
  contested_by?: string | null;
}

/** The position of a playback. */
export interface PlaybackPosition {
  of: string;
  position: number;
  duration: number;
}

export interface OrderNumbers {
  order: number;
  direction: number | null;
  /** Absent in states of an earlier version. */
  direction_strength?: number | null;
  drift: number | null;
}

export interface Certificate {
  contacts: number;
}

export interface OrderMessage extends Stamp {
  n: number;
  informed: number;
  order: OrderNumbers;
  certificate: Certificate;
  real_time_factor: number | null;
  measures?: Record<string, number | null>;
}

export type Choice = string | { kind: string };

/** The reply to `get/measures`. */
export interface Measures {
  measures: { name: string; value: number | null; unit: string }[];
}

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
  value: unknown;
  live: boolean;
  changed_by: string[];
}

export interface SwarmEvent extends Stamp {
  number: number;
  /** The daemon's wall clock, seconds since 1970; older daemons send none. */
  unix_secs?: number | null;
  event: { kind: string } & Record<string, unknown>;
}

export interface EventsResult {
  events: SwarmEvent[];
  newest: number;
}

/** The part of a swarm's status that the page reads. */
export interface Status {
  /** The conditions that it waits for; left out without any. */
  conditions?: WaitingCondition[];
}

export interface WaitingCondition {
  id: string;
  condition: string;
  action: "pause" | "commands" | "event";
  event?: string;
  client: string | null;
  /** False if it costs too much, and therefore does not hold. */
  evaluated?: boolean;
}

export interface ExperimentFile {
  file: string;
  steps: number;
  state_hash: string;
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
  measures?: string[];
}

/** A text message of the WebSocket; each has one of these fields. */
export interface LiveText {
  swarms?: SwarmRow[];
  order?: OrderMessage;
  event?: SwarmEvent;
  missed?: number;
  gone?: boolean;
}
