// Written by `cargo run --release -p jostle-contract`; not by hand.

/** What a daemon sends. A newer one may send more, and fields with `?` may be missing. */

/** The reply to `advance`. */
export interface AdvanceResult {
  /** The last step that is durable: a crash of the daemon does not undo it. */
  durable_step: number;
  /** What happened since the last reply to this controller. */
  news: News;
  /** The state after the steps, if requested. A retry of the request gets the cached reply, which has no state if the first one took more than 4 KiB: the reply is then JSON. */
  state?: State | null;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
  /** How many steps were taken; fewer than asked for if another command came between. */
  steps: number;
}

/** The reply of a swarm, and of the node that created one. The reply to a query on a swarm's `state` is the state alone. */
export interface Reply<T> {
  /** Increases when `step` does not continue what was published before. */
  epoch: number;
  /** The phase after the command. */
  phase: Phase;
  /** The result. */
  result: T;
  /** Number of commands applied to the swarm. */
  seq: number;
  /** The step at which the command took effect; for `step`, the step reached. */
  step: number;
  /** The swarm's name. */
  swarm: string;
  /** `step · dt`, body sizes over free speed. */
  time: number;
}

/** What a daemon attaches to a published state, in CBOR: times of its clock, and set-points. It is no part of the state, so that equal states have equal bytes. If the clock is set back in between, the second time is the earlier. */
export interface Attachment {
  /** When the daemon published the state, nanoseconds since 1970, UTC; `null` in a recording by the daemon. */
  published_unix_nanos: number | null;
  /** The numbers of the newest set-points in the state, the `sequence` of each put, by controller. Controllers in lock-step have none. */
  sequences: Record<string, number>;
  /** When the step that led to the state was taken, nanoseconds since 1970, UTC; `null` if the daemon does not know: before the first step, after a reset or a restart until the next one, and in a playback. */
  stepped_unix_nanos: number | null;
}

/** What an individual turns towards. */
export type Attraction = {
  /** About how far off that mean may be, its largest length being 1: 1e-9 to 1e-3. It is measured and no bound: in one group the largest error is at most this, in several flocks far apart up to ten times as much. Worth it from some thousand individuals on. Exact to rounding if left out. */
  accuracy?: number | null;
  kind: "all";
} | {
  kind: "voronoi";
} | {
  kind: "metric";
  /** The distance, body sizes: above 0. */
  radius: number;
} | {
  kind: "topological";
  /** How many: 1 or more. */
  neighbours: number;
} | {
  /** The exponent: -8 to 8; 0 is `all`. */
  exponent: number;
  kind: "power";
};

/** A page of the audit log: who sent which commands, oldest first. */
export interface Audit {
  /** Number of selected lines that are damaged, and therefore missing. */
  damaged: number;
  /** The lines that the request selects, as many as one reply holds. */
  lines: AuditLine[];
  /** The number of the newest line; 0 before the first. */
  newest: number;
  /** The number of the oldest stored line; `null` if there is none. */
  oldest: number | null;
}

/** Equal commands of one client within a minute. */
export interface AuditLine {
  /** What an `experiment`, `record` or `replay` does, such as `cancel`; `null` for other verbs. */
  action: string | null;
  /** The name that the client gives itself; `null` if it gives none. */
  client: string | null;
  /** Number of commands. */
  count: number;
  /** The same for the last of them. */
  last_unix_secs: number;
  /** The swarm, experiment or recording; of `create`, `restore` and `replay` the new swarm. */
  name: string | null;
  /** The number of the line, from 1. */
  number: number;
  /** How the commands ended. Those missing to `count` had no outcome when the line was stored. */
  outcomes: AuditOutcome[];
  /** The daemon's wall clock when it received the first of them, seconds since 1970, UTC. */
  unix_secs: number;
  /** The user of the token; `null` from a daemon without users, and for an unknown token. */
  user: string | null;
  /** The verb. */
  verb: string;
}

/** How commands ended. */
export interface AuditOutcome {
  /** Number of commands that ended so. */
  count: number;
  /** `ok`, the code of the error, such as `permission_denied`, or `abandoned` of a command that ended because its client was gone. */
  outcome: string;
}

/** A controller that the others wait for in lock-step. */
export interface Awaited {
  /** Its name. */
  controller: string;
  /** Its deadline, seconds. */
  deadline_secs: number;
  /** Seconds that they have waited. */
  secs: number;
}

/** The reply to `batch`; `seq` has increased by the number of its changes. */
export interface BatchResult {
  /** The result of each change, in their order. */
  results: Changed[];
}

/** The accuracy of a state. */
export interface Certificate {
  /** Number of contacts that constrained the step. */
  contacts: number;
  /** Number of pairs with crossing axes. It is measured independently of the solver. */
  crossed: number;
  /** Number of steps since the start or reset with a larger residual. */
  degraded: number;
  /** Number of iterations of the solver. */
  iterations: number;
  /** The residual `max |min(λ, s)|` of the step that led here, body sizes: at most 1e-9 unless the step was degraded. */
  residual: number;
  /** The smallest gap between two bodies, body sizes; negative is overlap; `null` if no two are near. It is measured independently of the solver. */
  worst_gap: number | null;
}

/** The result of one change of a `batch`, which has the fields of its verb. */
export type Changed = {
  result: SetResult;
  verb: "set";
} | {
  result: IdsResult;
  verb: "inform";
} | {
  result: IdsResult;
  verb: "uninform";
} | {
  result: IdsResult;
  verb: "inject";
} | {
  result: IdsResult;
  verb: "remove";
};

/** Which of a pair's contacts constrain it. */
export type ContactRule = "endpoints" | "closest" | "clamped";

/** A controller that has joined. */
export interface Controller {
  /** Its name. */
  controller: string;
  /** Seconds that others wait for it, or that its set-points apply. */
  deadline_secs: number;
  /** Whether it may set turning rates and speeds. */
  driving: boolean;
  /** The ids of the individuals that it steers. */
  ids: number[];
  /** Number of deadlines missed in a row. */
  misses: number;
  /** `lockstep` or `free_running`. */
  mode: Mode;
  /** What happens to its individuals when it is late. */
  on_timeout: OnTimeout;
  /** The outcomes of its puts. */
  puts: Puts;
  /** The step that it has advanced to; `null` unless in lock-step. */
  target_step: number | null;
  /** Seconds that others have waited for it; `null` if they do not. */
  waited_secs: number | null;
}

/** The controllers that have joined a swarm. */
export interface ControllerList {
  /** The controllers that have joined, by name. */
  controllers: Controller[];
}

/** The reply to `create`, `fork` and `restore`. */
export interface CreateResult {
  /** False if an equal swarm existed. */
  created: boolean;
  /** Its spec, with all defaults. */
  spec: Spec;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
}

/** A controller that has left. */
export interface Departed {
  /** Its name. */
  controller: string;
  /** Why it has left. */
  why: Departure;
}

/** Why a controller has left. */
export type Departure = "left" | "lost" | "late";

/** The phase of a swarm in detail. */
export type Doing = {
  kind: "paused";
  /** Why. */
  reason: string;
} | {
  kind: "running";
  /** The step it will pause at; `null` if it runs for good. */
  until: number | null;
} | {
  kind: "stepping";
  /** That step. */
  until: number;
} | {
  kind: "faulted";
  /** Why. */
  reason: string;
};

/** How an individual is driven directly, beyond the paper. */
export interface Drive {
  /** The individual. */
  id: number;
  /** Factor of the free speed; `null` to move by itself. */
  speed: number | null;
  /** Turning rate, angle over time; `null` to turn by itself. */
  turn: number | null;
}

/** An earlier version of the model that computed steps of a swarm. */
export interface EarlierModel {
  /** The epoch of the last state that it computed. */
  epoch: number;
  /** The version. */
  model_version: number;
  /** The step of that state. */
  step: number;
}

/** The result of a command without one. */
export type EmptyResult = Record<string, unknown>;

/** An error. Clients branch on `code`; `message` has the remedy. */
export interface ErrorBody {
  /** The kind of error, such as `conflict`. */
  code: ErrorCode;
  /** For programs, such as `field` and `range`; may be empty. */
  details?: Record<string, unknown>;
  /** For people: what is wrong, and the remedy. */
  message: string;
  /** The swarm's step at that time; `null` if it concerns no swarm. */
  step?: number | null;
}

/** The kinds of errors. */
export type ErrorCode = "not_found" | "already_exists" | "invalid_argument" | "incorrect_state" | "resource_exhausted" | "busy" | "conflict" | "contested" | "permission_denied" | "storage_full" | "deadline_exceeded" | "faulted" | "internal";

/** An event of a swarm. A gap in the numbers shows a reader that it missed some. */
export interface EventMessage {
  /** Increases when `step` does not continue what was published before. */
  epoch: number;
  /** What happened. */
  event: EventKind;
  /** The number of the event, from 1. */
  number: number;
  /** The phase after the event. */
  phase: Phase;
  /** The step of the event. */
  step: number;
  /** The swarm's name. */
  swarm: string;
  /** `step · dt`, body sizes over free speed. */
  time: number;
  /** The daemon's wall clock, seconds since 1970, UTC; `null` if it is not known. */
  unix_secs?: number | null;
}

/** What happened. */
export type EventKind = {
  /** The name of the client that sent the command. */
  client?: string | null;
  kind: "created";
  /** The id of the request. */
  request_id?: string | null;
  /** The verb that created it: `create`, `restore`, `fork` or `replay`; `null` if it is not known, as for a swarm that an earlier version created. */
  verb?: string | null;
} | {
  kind: "phase";
  /** The cause. */
  reason: string | null;
} | {
  /** The arguments of the command, as they were sent. */
  args: unknown;
  /** The name of the client that sent the command. */
  client: string | null;
  kind: "command";
  /** The id of the request. */
  request_id: string | null;
  /** Number of commands applied to the swarm. */
  seq: number;
  /** The verb of the command. */
  verb: string;
} | {
  /** The step that the command waits for. */
  applies_at_step: number;
  /** The arguments of the command, as they were sent. */
  args: unknown;
  /** The name of the client that sent the command. */
  client: string | null;
  kind: "scheduled";
  /** The id of the request. */
  request_id: string | null;
  /** The verb of the command. */
  verb: string;
} | {
  /** The arguments of the command, as they were sent. */
  args: unknown;
  /** The name of the client that sent the command. */
  client: string | null;
  /** Why the command was rejected. */
  error: ErrorBody;
  kind: "refused";
  /** The id of the request. */
  request_id: string | null;
  /** The verb of the command. */
  verb: string;
} | {
  /** The ids of the individuals concerned, ascending. */
  ids: number[];
  kind: "lapsed";
} | {
  kind: "fault";
  /** The cause. */
  reason: string;
} | {
  /** The version that computed that state. */
  from: number;
  kind: "model";
  /** The version that computes the steps from there on. */
  to: number;
} | {
  kind: "recording_failed";
  /** The cause. */
  reason: string;
  /** The name of the daemon's recording. */
  recording: string;
} | {
  /** The name of the client that sent the command. */
  client?: string | null;
  kind: "deleted";
  /** The id of the request. */
  request_id?: string | null;
};

/** A page of the events that a daemon stores of a swarm. */
export interface Events {
  /** The events of the page, oldest first. */
  events: EventMessage[];
  /** The number of the newest event: query until it is reached; 0 before the first. */
  newest: number;
  /** The number of the oldest stored event; `null` if there is none. */
  oldest: number | null;
}

/** How exact a step was. */
export interface Exactness {
  /** How many contacts constrained it. */
  contacts: number;
  /** How many steps since the start or reset missed the target residual. */
  degraded: number;
  /** How many iterations it took. */
  iterations: number;
  /** Its residual, body sizes. */
  residual: number;
}

/** A run as the swarm and the commands that have its states. */
export interface ExpandedRun {
  /** The commands to send, in this order. */
  commands: RunCommand[];
  /** Its name. */
  run: string;
  /** The snapshot from which `restore` creates the swarm, its CBOR as base64; left out if `create` creates it from `spec`. */
  snapshot?: string | null;
  /** The spec of the swarm, with the seed of the run. */
  spec: Spec;
  /** The number of its steps, at most. */
  steps: number;
  /** The condition that ends the run and pauses the swarm; `null` if there is none. */
  stop: string | null;
}

/** The commands of a swarm since its start, as the file of an experiment with one run. The parameter `replicates` of the query gives the run other seeds, so many. The file contains the set-points of controllers as the text of a CSV; with the parameter `setpoints`, a name of a file, it names that one. */
export interface ExperimentFile {
  /** The text of the file, TOML. Its run takes the steps of the swarm. */
  file: string;
  /** The text of the CSV of set-points that the file names; left out if it names none. */
  setpoints?: string | null;
  /** BLAKE3 of the state at that step, in hexadecimal. The run ends with it, unless commands were applied at that step: then the run takes one more step. */
  state_hash: string;
  /** The step of the swarm. */
  steps: number;
}

/** What an experiment is doing. */
export type ExperimentPhase = "queued" | "running" | "paused" | "finished" | "cancelled" | "failed";

/** The reply to a command about an experiment. */
export interface ExperimentResult {
  /** Whether the command created it. */
  created: boolean;
  /** The run of `expand`; left out by other commands. */
  expanded?: ExpandedRun | null;
  /** Its progress; of a deleted one, its last; with `expand`, that at its beginning. */
  progress: Progress;
}

/** The experiments of a daemon. */
export interface Experiments {
  /** The experiments, in the order of submission. */
  experiments: Progress[];
}

/** The value of a column that only some experiments have. */
export interface ExtraValue {
  /** The column: a variable of the grid, `stopped_at`, or the mean of a measure such as `msd(5)`. */
  name: string;
  /** `stopped_at` in time units, a measure in its unit; `null` if it is undefined. */
  value: number | null;
}

/** What went wrong in a swarm that has faulted. `reason` says it in words. */
export interface Fault {
  /** The gap between the two bodies that cross, in the last good state, body sizes; `null` for others. */
  gap: number | null;
  /** The individuals that it is about; empty if it is about none in particular. */
  ids: number[];
  /** What it is: `crossed_bodies`; `not_solved`, if no solution of a step was exact enough; `overturned`, if the attraction turned an individual too far in one step; `not_finite`, if a position is no number; `other` if the step does not fail: a stored line is damaged, a replay had another hash, or the daemon has a defect. Later versions may have more. */
  kind: string;
}

/** The name, version and limits of a daemon. */
export interface Hello {
  /** Its data folder, by a number that the daemon drew when it began the folder's database; a restored backup has another one. A daemon with the same id has the replies to commands that were executed, so that a command can be sent again after a restart. Left out if the daemon could not store it. */
  data_id?: string | null;
  /** The address of its HTTP server, such as `https://0.0.0.0:8443`; left out if it has none. */
  http?: string | null;
  /** Its limits. */
  limits: Limits;
  /** Its clock: seconds since 1970, UTC. */
  unix_secs: number;
  /** The daemon's version. */
  version: string;
  /** The version of the contract that it speaks. */
  wire_version: number;
}

/** A histogram of a state. */
export interface Histogram {
  /** The number of ordered pairs of individuals in each bin. The bins of `neighbour_density` are squares: rows from the back to the front, each from the right to the left. */
  counts: number[];
  /** The edges of the bins of one axis, body sizes: one more than the axis has bins. */
  edges: number[];
  /** Its name: `pair_correlation` or `neighbour_density`. */
  name: string;
  /** The unit of its values; `1` if they have none. */
  unit: string;
  /** The value of each bin. */
  values: number[];
}

/** The oldest stored checkpoint of a swarm: the history after it can be replayed. */
export interface HistoryFrom {
  /** Its epoch. */
  epoch: number;
  /** Its step. */
  step: number;
}

/** The reply to `inform`, `uninform`, `inject` and `remove`. */
export interface IdsResult {
  /** The ids of the individuals concerned, ascending. */
  ids: number[];
  /** The size of the group after the command. */
  n: number;
}

/** The reply to `join`. */
export interface JoinResult {
  /** The ids of the individuals that the controller steers. */
  ids: number[];
  /** What happened since it left, if it rejoins. */
  news: News;
}

/** A page of the commands that a daemon stores of a swarm. The spec and these commands determine the state of the swarm. */
export interface Journal {
  /** The entries of the page, oldest first. */
  entries: JournalEntry[];
  /** The `seq` of the newest entry; 0 before the first. */
  newest: number;
  /** The line of the journal at which the next page begins: query again with it as `line`, also if this page has no entries; left out after the last page, and in replies of earlier daemons. */
  next?: number | null;
  /** The `seq` of the oldest stored entry; `null` if there is none. */
  oldest: number | null;
}

/** A command that a swarm applied. */
export interface JournalEntry {
  /** Its arguments as they were sent. */
  args: unknown;
  /** The name of the client that sent it. */
  client: string | null;
  /** The epoch in which it was applied. */
  epoch: number;
  /** The id of the request. */
  request_id: string | null;
  /** The number of the command; each change of a `batch` has one, and its entry has that of the last. */
  seq: number;
  /** The step at which it was applied. */
  step: number;
  /** `step · dt`, body sizes over free speed. */
  time: number;
  /** The daemon's wall clock, seconds since 1970, UTC; `null` if it is not known, as in entries of older daemons. */
  unix_secs?: number | null;
  /** Its verb. */
  verb: string;
}

/** When an individual becomes uninformed again. */
export interface Lapse {
  /** At the end of which step. */
  at_step: number;
  /** The individual. */
  id: number;
}

/** The limits of a daemon. */
export interface Limits {
  /** Number of connected clients; beyond it `get/hello` is rejected with `resource_exhausted`. */
  max_clients: number;
  /** Published states per second and swarm. */
  max_hz: number;
  /** Number of individuals of a swarm. */
  max_individuals: number;
  /** Memory of all swarms together, bytes. */
  max_memory_bytes: number;
  /** Length of a request, bytes; a longer one is rejected, and zenoh drops one of more than 1 MiB without an error. */
  max_message_bytes: number;
  /** Number of swarms. */
  max_swarms: number;
}

/** One measure of a run over time. */
export interface MeasureSeries {
  /** Its name, as in the experiment's file. */
  name: string;
  /** Its value at each entry, `null` (in CBOR NaN) where it is undefined. */
  value: (number | null)[];
}

/** A measure of a state. */
export interface MeasureValue {
  /** Its name with its argument, unless that is the default: `order`, `clusters.count(0.1)`. */
  name: string;
  /** Its unit; `1` if it has none. */
  unit: string;
  /** Its value; `null` if it is undefined, such as `drift` without informed individuals. */
  value: number | null;
}

/** Measures of the newest state of a swarm, or a histogram of it. */
export interface Measures {
  /** The requested histogram of the newest state. */
  histogram?: Histogram | null;
  /** The requested measures of the newest state, in the requested order. */
  measures: MeasureValue[];
}

/** A joined controller, with all that is durable. */
export interface Member {
  /** Its `advance` without a reply yet. */
  advance?: Sent | null;
  /** Its name. */
  controller: string;
  /** How long others wait for it, or how long its set-points hold, seconds. */
  deadline_secs: number;
  /** Whether it may drive individuals directly. */
  driving: boolean;
  /** The step at which it began to. */
  from: number;
  /** The individuals that it may steer. */
  ids: number[];
  /** Deadlines missed in a row. */
  misses: number;
  /** When the swarm steps. */
  mode: Mode;
  /** What happened since the last reply to it. */
  news: News;
  /** What happens to its individuals when it is late. */
  on_timeout: OnTimeout;
  /** The number of its newest put that was applied. */
  sequence: number;
  /** The individuals that it has steered. */
  steered: number[];
  /** The step that it has advanced to. */
  target: number;
}

/** A value of the metadata of a trajectory. */
export interface Metadata {
  /** Its key, such as `seed`. */
  key: string;
  /** Its value as text. */
  value: string;
}

/** Metrics of a daemon; counters begin when it starts. */
export interface Metrics {
  /** Number of names, the daemon's and its swarms', that another daemon has too. */
  contested?: number;
  /** Number of cores that it may use. */
  cores: number;
  /** CPU seconds of its threads. */
  cpu_secs: number;
  /** Number of steps that missed the target residual, but were acceptable. */
  degraded: number;
  /** Bytes of all experiments on disk; `null` from an earlier daemon. */
  experiments_bytes?: number | null;
  /** The limit of these bytes, at which the running experiment is paused, and none begins; `null` if there is none. */
  experiments_quota_bytes?: number | null;
  /** Number of failed steps; each stops its swarm. */
  faults: number;
  /** Number of states for publication. */
  frames: number;
  /** Number of states that a newer one replaced before publication. */
  frames_dropped: number;
  /** Memory in use, bytes. */
  memory_bytes: number;
  /** The recordings. */
  recordings?: RecordingMetrics;
  /** Bytes of all recordings on disk. */
  recordings_bytes?: number;
  /** The limit of these bytes: running recordings end at it, and none begins. */
  recordings_quota_bytes?: number;
  /** The largest residual of a step, body sizes. */
  residual_max: number;
  /** Number of connected clients. */
  sessions: number;
  /** Seconds that these steps took. */
  step_secs: number;
  /** Number of steps of all swarms, also of deleted ones. */
  steps: number;
  /** The database. */
  store: StoreMetrics;
  /** Every swarm, ordered by name. */
  swarms: SwarmMetrics[];
  /** The reasons why it is unhealthy, for people; empty if it is healthy. */
  unwell: string[];
  /** Seconds since it started. */
  uptime_secs: number;
  /** Problems that do not stop its work, for people, such as a failed recording; empty if there are none. */
  warnings?: string[];
}

/** A missed deadline. */
export interface Miss {
  /** The controller that missed it. */
  controller: string;
  /** Number of misses in a row: with the third the controller has left. */
  misses: number;
  /** The step at which the swarm waited. */
  step: number;
}

/** When a swarm with a controller steps. */
export type Mode = "lockstep" | "free_running";

/** What happened between two replies to a controller. */
export interface News {
  /** Controllers that have left. */
  left: Departed[];
  /** Missed deadlines, also its own. */
  missed: Miss[];
  /** Ids of individuals of its own that were removed. */
  removed: number[];
}

/** The reply of a node. */
export interface NodeReply<T> {
  /** The daemon's name. */
  node: string;
  /** The result. */
  result: T;
}

/** The status of a daemon. */
export interface NodeStatus {
  /** Number of connected clients. */
  clients: number;
  /** Of it, memory reserved for the running experiment, bytes. */
  experiments_memory_bytes?: number;
  /** Number of faulted swarms. */
  faulted: number;
  /** Number of individuals in all swarms. */
  individuals: number;
  /** Memory reserved for the swarms and the running experiment, bytes. */
  memory_bytes: number;
  /** Number of running swarms. */
  running: number;
  /** Number of swarms. */
  swarms: number;
  /** Seconds since it started. */
  uptime_secs: number;
}

/** The columns that only the tables of some experiments have, in their order. */
export interface OccasionalColumns {
  /** Those of the table of results, as `extra` of a row: variables, `stopped_at`, and means of measures. */
  extra: string[];
  /** The measures over time. */
  series: string[];
  /** The values that vary in the names of the runs, such as `pi1`. */
  varied: string[];
}

/** What happens to the individuals of a late controller. */
export type OnTimeout = "hold" | "free" | "pause";

/** The order and drift of a swarm, now and as means since the start or the last reset. Speeds are in free speeds; the means are over steps. */
export interface Order {
  /** The common direction of the informed individuals, radians: that of the sum of their directions, each times its weight; `null` if there are none, or they disagree so much that `direction_strength` is below 0.1. */
  direction: number | null;
  /** How far they agree, the length of that sum divided by the sum of the weights: 0 to 1; `null` if there are none, and from an earlier version. */
  direction_strength?: number | null;
  /** The centroid's velocity along that direction, free speeds; `null` without one. */
  drift: number | null;
  /** Its mean over the steps with such a direction. */
  mean_drift: number | null;
  /** Its time mean, `v` of eq. (8); `null` before the first step. */
  mean_order: number | null;
  /** Its time mean; `null` before the first step. */
  mean_velocity: [number, number] | null;
  /** The polar order parameter, the length of the mean heading: 0 to 1; eq. (8) without the mean. */
  order: number;
  /** The mean heading (x, y), which is the centroid's velocity in free speeds. */
  velocity: [number, number];
}

/** A run's order over time, if the experiment measures it. In CBOR the columns are RFC 8746 typed arrays, little-endian. */
export interface OrderPage {
  /** The drift along the informed individuals' direction at each, `null` (in CBOR NaN) where it is undefined; empty if it is undefined everywhere. */
  drift: (number | null)[];
  /** The experiment's name. */
  name: string;
  /** Where to ask on, as `after`; `null` if there is no more. */
  next: number | null;
  /** The polar order parameter at each. */
  order: number[];
  /** The run's name. */
  run: string;
  /** The times of the entries. */
  time: number[];
  /** How many entries the run has. Left out by earlier versions. */
  total?: number | null;
}

/** A published order. */
export interface OrderSample {
  /** How exact the state is. */
  certificate: Certificate;
  /** Increases when `step` does not continue what was published before. */
  epoch: number;
  /** The number of its published state. */
  frame: number;
  /** How many individuals are informed. */
  informed: number;
  /** The measures that the swarm publishes, by name, each in its unit; a value is `null` where it is undefined or the group too large. Left out without any. */
  measures?: Record<string, number | null> | null;
  /** The number of individuals. */
  n: number;
  /** Order and drift. */
  order: Order;
  /** The phase of the swarm. */
  phase: Phase;
  /** Time units per second of wall clock that the swarm is asked to run at; `null` is as fast as possible. */
  rate: number | null;
  /** The rate that was reached lately; `null` while it does not run. */
  real_time_factor: number | null;
  /** The number of steps since the start. */
  step: number;
  /** The swarm's name. */
  swarm: string;
  /** `step · dt`, body sizes over free speed. */
  time: number;
}

/** What a swarm was made from. */
export interface Origin {
  /** How it was made. */
  kind: OriginKind;
  /** The number of its commands before; `null` for a replay. */
  seq: number | null;
  /** BLAKE3 of its state then, in hexadecimal; `null` for a replay. */
  state_hash: string | null;
  /** Its step then. */
  step: number;
  /** The swarm that was forked, saved in a snapshot or recorded; `null` if a snapshot has no name that a swarm can have. */
  swarm: string | null;
  /** The number of that swarm in the store of this daemon; `null` if it may be of another daemon. */
  swarm_id: number | null;
}

/** How a swarm was made from another one. */
export type OriginKind = "fork" | "restore" | "play";

/** A parameter of a swarm, with the data of a form or a slider. */
export interface Parameter {
  /** The verbs that change it. */
  changed_by: string[];
  /** The values of a choice, without their numbers; empty otherwise. */
  choices: unknown[];
  /** The default; `null` if it must be given. */
  default: unknown;
  /** A description in one line. */
  doc: string;
  /** The value must be above this; `null` if there is no such bound. */
  exclusive_minimum: number | null;
  /** The type of its values: `number`, `integer` or `choice`. */
  kind: ParameterKind;
  /** Whether a command can change it. */
  live: boolean;
  /** The largest value at present; `null` if there is none. */
  maximum: number | null;
  /** The smallest value; `null` if there is none. */
  minimum: number | null;
  /** Its name in the spec. */
  name: string;
  /** Whether `null` is a value. */
  nullable: boolean;
  /** Its unit; `1` if it has none. */
  unit: string;
  /** Its usual values; `null` if it has none, and of daemons of earlier versions. */
  usual?: Usual | null;
  /** The present value. */
  value: unknown;
}

/** What values a parameter takes. */
export type ParameterKind = "number" | "integer" | "choice";

/** The values of the parameters that commands can change. */
export interface ParameterValues {
  /** The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes faster from some thousand individuals on; others are `voronoi`, `metric` with a `radius` in body sizes, `topological` with a number of `neighbours`, and `power` with an `exponent`. */
  attraction: Attraction;
  /** Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one with the smallest gap; or, for comparison, `clamped`, which adds redundant ones. */
  contacts: ContactRule;
  /** Seconds that the swarm waits for a controller in lock-step that sends nothing; left out without a limit. */
  max_idle_secs?: number | null;
  /** The measures in each published order; left out without any. */
  measures?: string[] | null;
  /** Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶. */
  noise: number;
  /** Length over width of a body: 1 (a disc) to 32. */
  pi1: number;
  /** Weight of individuals that are informed without a weight: 0 to 10⁶. */
  pi2: number;
  /** Body size over turning radius: above 0, to 10⁶. */
  pi3: number;
  /** Translational over rotational drag: above 0, to 10⁶. */
  pi4: number;
  /** Number of steps between two published states: 1 or more. */
  publish_every: number;
  /** Number of further programs that a step solves about the result of the last one: 0, or 1, which leaves less overlap and requires `position`. */
  relinearise: number;
  /** What a contact limits: `position`, the gap after the step, or `velocity`, the speed at which touching bodies approach each other. */
  stepping: Stepping;
}

/** All parameters of a swarm except its start. */
export interface Parameters {
  /** All but the start, in the order of the spec. */
  parameters: Parameter[];
}

/** The positions and headings of all individuals after an earlier step, as columns. */
export interface PastFrame {
  /** Headings in radians. */
  alpha: number[];
  /** Ids. */
  id: number[];
  /** Where the positions are counted from, in units of 1024 body sizes. */
  origin: [number, number];
  /** The number of steps taken. */
  step: number;
  /** Positions relative to the origin, body sizes. */
  x: number[];
  /** Positions relative to the origin, body sizes. */
  y: number[];
}

/** A `step` that is being executed. */
export interface Pending {
  /** The step it began at. */
  from: number;
  /** The command. */
  sent: Sent;
}

/** The phase of a swarm. */
export type Phase = "paused" | "running" | "faulted";

/** The progress of an experiment, published while it changes, at most twice a second. */
export interface Progress {
  /** Seconds that it has run, without pauses. */
  elapsed_secs: number;
  /** Number of finished runs that ended early. */
  faulted: number;
  /** Number of finished runs. */
  finished: number;
  /** Seconds that it will still take, without pauses; `null` while there is no estimate. */
  left_secs: number | null;
  /** Why it failed or the daemon paused it, or a remark on its runs; `null` without one. */
  message: string | null;
  /** The version of the model that executed its finished runs, if the daemon has another one: no run is added to them, and they remain readable. Left out if the daemon has this one. */
  model_version?: number | null;
  /** The experiment's name. */
  name: string;
  /** Its phase. */
  phase: ExperimentPhase;
  /** The runs that are being executed. */
  running: RunUnderWay[];
  /** Number of runs. */
  runs: number;
  /** The finished share of the work, 0 to 1, with that of the present runs. */
  share: number;
  /** The earliest version of the model that computed a part of the snapshot from which its runs start, if it is before that of the runs. Left out otherwise. */
  start_model_version?: number | null;
}

/** Numbers of a controller's puts, by outcome. */
export interface Puts {
  /** Applied ones. */
  applied: number;
  /** Those that a newer one overtook before the next step. */
  overtaken: number;
  /** Those that were unreadable, out of range, not permitted, or for individuals of another controller. */
  refused: number;
  /** Those that were not newer than one before, or of another epoch. */
  stale: number;
}

/** The epoch and step of a state in a recording. */
export interface RecordedAt {
  /** Its epoch. */
  epoch: number;
  /** Its step. */
  step: number;
}

/** The status of a recording of a daemon; of a deleted one, its last status. */
export interface Recording {
  /** Its beginning, seconds since 1970, UTC. */
  began_unix_secs: number;
  /** Bytes of these files. */
  bytes: number;
  /** Whether it drops states while the disk is too slow; otherwise the swarm waits. */
  drop_when_behind?: boolean;
  /** It has the states whose step is a multiple of this; `null` is the published states, of an earlier version. */
  every: number | null;
  /** `mcap`, or `parquet` if an earlier version recorded it. */
  format: RecordingFormat;
  /** Number of recorded states. */
  frames: number;
  /** Where the last of these were; `null` if none was lost. */
  gap?: RecordingGap | null;
  /** Number of them that were lost because the daemon ended before their file was complete. */
  lost?: number;
  /** Number of finished files that are missing or damaged; `frames`, `parts` and `bytes` are those of the others then. */
  lost_parts?: number;
  /** The size in bytes at which it ends; `null` for a recording of an earlier version, which has no limit. */
  max_bytes?: number | null;
  /** Number of missing states: those that were dropped because the disk was too slow (without `drop_when_behind` the swarm waits instead), and those in `lost`. */
  missed: number;
  /** Number of complete files. */
  parts: number;
  /** Its phase. */
  phase: RecordingPhase;
  /** Why it ended or failed, and which of its files are missing or damaged. */
  reason: string | null;
  /** Its name, and that of its folder in `recordings` of the daemon's data directory. */
  recording: string;
  /** The name of the recorded swarm. */
  swarm: string;
  /** Whether the client that fetches it is to delete it afterwards. */
  temporary?: boolean;
}

/** How a recording is written: as MCAP, unless an earlier version wrote it. */
export type RecordingFormat = "mcap" | "parquet";

/** States that a recording lost because the daemon ended before their file was complete. */
export interface RecordingGap {
  /** The state up to which none is missing; `null` if the recording begins with the gap. */
  after: RecordedAt | null;
  /** Number of missing states. */
  missed: number;
  /** The state at which the recording continues. */
  until: RecordedAt;
}

/** Numbers of a daemon's recordings, by phase. */
export interface RecordingMetrics {
  /** Number of ended recordings. */
  ended: number;
  /** Number of failed recordings. */
  failed: number;
  /** Number of running recordings. */
  recording: number;
}

/** What a recording is doing. */
export type RecordingPhase = "recording" | "ended" | "failed";

/** A piece of a complete part of a recording. */
export interface RecordingPiece {
  /** The piece, as base64: at most 512 KiB of the part; empty at the end of the part. */
  bytes: string;
  /** The length of the part, bytes. */
  length: number;
  /** The offset of the piece in the part, bytes. */
  offset: number;
  /** The number of the part, from 0. */
  part: number;
  /** Number of complete parts. */
  parts: number;
  /** The name of the recording. */
  recording: string;
}

/** The recordings of a daemon. */
export interface Recordings {
  /** The recordings, ordered by name. */
  recordings: Recording[];
}

/** A playback of a recording. */
export interface Replay {
  /** Time units from its first frame to its last, resets and gaps left out. */
  duration: number;
  /** The number of the present frame, from 1. */
  frame: number;
  /** Number of frames. */
  frames: number;
  /** The swarm that was recorded. */
  of: string;
  /** Time units since its first frame. */
  position: number;
}

/** The reply to `replay`. */
export interface ReplayResult {
  /** The playback after `open`; `null` after `upload`. */
  replay: Replay | null;
  /** Number of uploaded bytes, which is the offset of the next piece; `null` after `open`. */
  uploaded: number | null;
}

/** The reply to `reset`. */
export interface ResetResult {
  /** The seed of the swarm. */
  seed: number;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
}

/** The result of one run of an experiment: a row of the table of results. */
export interface ResultRow {
  /** The contact rule: `endpoints`, `closest` or `clamped`. */
  contacts: string;
  /** The share of time in which any two axes crossed. */
  crossed_share: number;
  /** Number of degraded steps: less accurate than the target, but acceptable. */
  degraded: number;
  /** The time step. */
  dt: number;
  /** Columns that only some experiments have, in their order: variables of the grid, `stopped_at`, and means of chosen measures. */
  extra?: ExtraValue[];
  /** Number of steps that the fallback solved because the exact solver missed its target. */
  fallbacks: number;
  /** Why the run ended early, if a fault ended it; left out otherwise. The other values are then those of the time before the fault. */
  fault?: string | null;
  /** Number of informed individuals. */
  informed: number;
  /** Number of individuals. */
  n: number;
  /** Number of intervals with an order of at least 2/3, including those that the run's ends cut. */
  ordered_intervals: number;
  /** Total time of the ordered intervals. */
  ordered_time: number;
  /** Length over width of a body. */
  pi1: number;
  /** Weight of the informed individuals' own preference. */
  pi2: number;
  /** Body size over turning radius. */
  pi3: number;
  /** Translational over rotational drag. */
  pi4: number;
  /** The run's name within its experiment: the varied parameters, then the replicate. The seed is derived from the name. */
  run: string;
  /** The seed of all random draws. */
  seed: number;
  /** The hash of the last state, BLAKE3 in hexadecimal. */
  state_hash: string;
  /** Number of steps. */
  steps: number;
  /** Duration of the run; less than that of the experiment if the run faulted. */
  time: number;
  /** Number of intervals with an order below 2/3, including those that the run's ends cut. */
  unordered_intervals: number;
  /** Total time of the unordered intervals. */
  unordered_time: number;
  /** Time mean of the centroid's speed, eq. (8). */
  v: number;
  /** Mean drift along the informed individuals' direction; `null` without informed individuals. */
  v_pd: number | null;
  /** The deepest overlap of any two bodies, 0 or more. */
  worst_overlap: number;
  /** The largest residual of any step. */
  worst_residual: number;
}

/** Some rows of an experiment's table of results, in the order of its plan. */
export interface ResultsPage {
  /** The columns that only some experiments have, so that a table without rows has them, too; left out in replies of earlier versions. */
  columns?: OccasionalColumns | null;
  /** Number of finished runs. */
  finished: number;
  /** The experiment's name. */
  name: string;
  /** The number to request the next page after, as `after`; `null` after the last page. */
  next: number | null;
  /** The rows of the finished runs, faulted ones included, after the requested run. */
  rows: ResultRow[];
}

/** What a person may do. Each may do what the one before may. */
export type Role = "viewer" | "controller" | "operator";

/** A command of a run, and its `at_step`. */
export interface RunCommand {
  /** The arguments of the verb. */
  args: unknown;
  /** The step before which it is executed; `null` if it is executed at once. */
  at_step: number | null;
  /** `batch`: the changes of one execution of an `[[at]]` block; `when`: a block with a condition, or `[stop]`. */
  verb: string;
}

/** The reply to `run`. */
export interface RunResult {
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The step it will pause at; `null` if it has no end. */
  until_step: number | null;
}

/** A run that is being executed. */
export interface RunUnderWay {
  /** Its name. */
  run: string;
  /** The finished share of its steps, 0 to 1. */
  share: number;
}

/** How values are spread over a range. */
export type Scale = "linear" | "logarithmic";

/** The reply to a command with an `at_step` that lies ahead. */
export interface Scheduled {
  /** The step at which the command will be executed; an event then has its result. */
  applies_at_step: number;
}

/** The JSON Schemas (2020-12) of every message. */
export interface Schemas {
  /** The schemas by the name of the message, such as `step.args` and `step.reply`. */
  schemas: Record<string, unknown>;
  /** The version of the contract that they describe. */
  wire_version: number;
}

/** A command as received. */
export interface Sent {
  /** Its arguments, JSON. */
  args: string;
  /** The client, as the request names it. */
  client: string | null;
  /** Distinguishes it from another request with the same id. */
  digest: number[] | null;
  /** The id that its client gave it. */
  request_id: string | null;
  /** The verb. */
  verb: string;
}

/** The chosen measures of a run over time, if the experiment has `series_every`; or with `of=individuals` its trajectory, if the experiment has `record_every`. An entry of a trajectory is an individual at a step. Its measures are `id`, `x`, `y` and `alpha`, as in a state but with absolute positions, and `informed`, 1 or 0. In CBOR the columns are RFC 8746 typed arrays, little-endian. */
export interface SeriesPage {
  /** The metadata of a trajectory, in its first page: the `spec` and the `variables` of the run as JSON, its `seed`, the `units` of the columns as JSON, and the `version` of the daemon. */
  about?: Metadata[] | null;
  /** The measures, in the order of the experiment's file. */
  measures: MeasureSeries[];
  /** The experiment's name. */
  name: string;
  /** Where to ask on, as `after`; `null` if there is no more. */
  next: number | null;
  /** The run's name. */
  run: string;
  /** The steps of the entries. */
  step: number[];
  /** The times of the entries. */
  time: number[];
  /** How many entries the run has. Left out by earlier versions. */
  total?: number | null;
}

/** The reply to `set`. */
export interface SetResult {
  /** The values before. */
  before: ParameterValues;
  /** The values now. */
  now: ParameterValues;
  /** As in `Status`; left out in a `batch`. */
  published_hz?: number | null;
  /** The factor by which `make_room` scaled the positions; 1 is not at all. */
  scaled_by: number;
}

/** A swarm with all that its future depends on. In CBOR the columns are RFC 8746 typed arrays, little-endian. */
export interface Snapshot {
  /** Headings in radians. */
  alpha: number[];
  /** How many of them were annotations, which the numbers of random draws leave out. */
  annotations?: number;
  /** The controllers that have joined. */
  controllers?: Member[];
  /** BLAKE3, in hexadecimal, of the snapshot in CBOR without this; a snapshot that is sent has one. */
  digest?: string | null;
  /** Preferred directions in radians. */
  direction: number[];
  /** What it is doing. */
  doing: Doing;
  /** Who is driven directly, by a controller. */
  drives?: Drive[];
  /** The earlier versions of the model that computed steps before, oldest first; left out without any. */
  earlier_models?: EarlierModel[];
  /** Grows whenever `step` does not continue what was published before. */
  epoch: number;
  /** How many events there have been. */
  events?: number;
  /** How exact the last step was. */
  exactness: Exactness;
  /** Ids; never used twice. */
  id: number[];
  /** Whether the swarm was put away after it. */
  is_last?: boolean;
  /** Who is uninformed again, and at the end of which step. */
  lapses: Lapse[];
  /** How many lines of its journal it contains. */
  lines?: number;
  /** What the solver carries from one step to the next. */
  memory: SolverMemory;
  /** The version of the model that computed it: another one has another future. */
  model_version: number;
  /** The id of the next individual. */
  next_id: number;
  /** Two integers: where the positions are counted from, in units of 1024 body sizes. */
  origin: [number, number];
  /** The values of the parameters that may change. */
  parameters: SnapshotParameters;
  /** The positions and headings of earlier steps that the measures of these conditions need, by ascending step. */
  past?: PastFrame[];
  /** A `step` that is being executed. */
  pending?: Pending | null;
  /** Whether it is protected from `delete` and `reset`; a swarm that is restored from this is not. */
  protected?: boolean;
  /** The number of changes by commands of a protocol, which numbers their random draws. */
  protocol_draws?: number;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The commands that wait for their step, in the order they come due. */
  scheduled: Waiting[];
  /** Counts the applied commands. */
  seq: number;
  /** Its spec with the current seed. */
  spec: Spec;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
  /** The number of steps since the start. */
  step: number;
  /** Sums over the steps since the start or reset. */
  sums: Sums;
  /** The swarm's name. */
  swarm: string;
  /** The version of this layout. */
  version: number;
  /** Weights of the preferred directions; 0 for the uninformed. */
  weight: number[];
  /** The conditions that it waits for, in the order of their commands. */
  when?: StoredCondition[];
  /** Positions relative to the origin, body sizes. */
  x: number[];
  /** Positions relative to the origin, body sizes. */
  y: number[];
}

/** The values of the parameters that may change while a swarm lives. What is left out is as in `spec`: snapshots were made before the rules and the noise could change. */
export interface SnapshotParameters {
  /** What an individual turns towards. */
  attraction?: Attraction | null;
  /** Which of a pair's contacts constrain it. */
  contacts?: ContactRule | null;
  /** For how many seconds the swarm waits for a controller in lock-step that sends nothing; left out without a limit. */
  max_idle_secs?: number | null;
  /** The measures in each published order; left out without any. */
  measures?: string[] | null;
  /** Intensity of white noise on the turning rate, squared angle over time. */
  noise?: number | null;
  /** Length over width of a body. */
  pi1: number;
  /** Weight of individuals informed without one. */
  pi2: number;
  /** Body size over turning radius. */
  pi3: number;
  /** Translational over rotational drag. */
  pi4: number;
  /** Steps between two published states. */
  publish_every: number;
  /** How many more programs a step solves about what the last one predicts. */
  relinearise?: number | null;
  /** What a contact limits. */
  stepping?: Stepping | null;
}

/** What the solver carries from one step to the next: the contacts that pushed, as columns, and the order of elimination. */
export interface SolverMemory {
  /** Which ends touch. */
  code: number[];
  /** The first of the pair, by id. */
  first: number[];
  /** How hard they pushed. */
  multiplier: number[];
  /** The order in which individuals are eliminated, by index. */
  order: number[];
  /** How many programs were solved in that order. */
  order_age: number;
  /** The second of the pair, by id. */
  second: number[];
}

/** The spec of a swarm: equal specs give equal states, bit for bit. Lengths are in body sizes, speeds in free speeds, times in their quotient. Table 1 of the paper defines π1 to π4. Only `n` is required. */
export interface Spec {
  /** The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes faster from some thousand individuals on; others are `voronoi`, `metric` with a `radius` in body sizes, `topological` with a number of `neighbours`, and `power` with an `exponent`. */
  attraction?: Attraction;
  /** Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one with the smallest gap; or, for comparison, `clamped`, which adds redundant ones. */
  contacts?: ContactRule;
  /** The time step: above 0, and so short that no point of a body's axis travels further than a body's width. */
  dt?: number;
  /** The measures in each published order, such as `milling`, at most 16 that need no earlier state; no measures if left out. */
  measures?: string[] | null;
  /** The number of individuals: 1 to the daemon's limit; in a spec the number at the start. */
  n: number;
  /** Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶. */
  noise?: number;
  /** Length over width of a body: 1 (a disc) to 32. */
  pi1?: number;
  /** Weight of individuals that are informed without a weight: 0 to 10⁶. */
  pi2?: number;
  /** Body size over turning radius: above 0, to 10⁶. */
  pi3?: number;
  /** Translational over rotational drag: above 0, to 10⁶. */
  pi4?: number;
  /** Number of steps between two published states: 1 or more. */
  publish_every?: number;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate?: number | null;
  /** Number of further programs that a step solves about the result of the last one: 0, or 1, which leaves less overlap and requires `position`. */
  relinearise?: number;
  /** The seed of all random draws: 0 to 2⁵³ - 1. */
  seed?: number;
  /** Where the individuals begin: in a `disc`, or at `given` poses. */
  start?: Start;
  /** What a contact limits: `position`, the gap after the step, or `velocity`, the speed at which touching bodies approach each other. */
  stepping?: Stepping;
}

/** Where the individuals begin. */
export type Start = {
  kind: "disc";
  /** The radius of the disc in body sizes, above 0; √n, at least 1, if left out. */
  radius?: number | null;
} | {
  /** Headings in radians, counter-clockwise from +x. */
  alpha: number[];
  kind: "given";
  /** Absolute positions, body sizes. */
  x: number[];
  /** Absolute positions, body sizes. */
  y: number[];
};

/** One published state: columns of n numbers, ordered by id. An individual's absolute position is `1024 · origin + (x, y)`. In CBOR the columns are RFC 8746 typed arrays, little-endian; in JSON plain arrays. */
export interface State {
  /** Headings in radians, counter-clockwise from +x, never wrapped. */
  alpha: number[];
  /** How exact this state is. */
  certificate: Certificate;
  /** Preferred directions in radians; 0 for the uninformed. */
  direction: number[];
  /** Grows whenever `step` does not continue what was published before. */
  epoch: number;
  /** Counts the published states, so that a reader can distinguish skipped from lost ones. */
  frame: number;
  /** Ids; never used twice. */
  id: number[];
  /** Order and drift. */
  order: Order;
  /** Two integers: where the positions are counted from, in units of 1024 body sizes. */
  origin: [number, number];
  /** The phase of the swarm. */
  phase: Phase;
  /** The number of steps since the start. */
  step: number;
  /** The swarm's name. */
  swarm: string;
  /** `step · dt`. */
  time: number;
  /** Weights of the preferred directions; 0 for the uninformed. */
  weight: number[];
  /** Positions relative to the origin, body sizes. */
  x: number[];
  /** Positions relative to the origin, body sizes. */
  y: number[];
}

/** The status of a swarm; its phase, step and time are in the envelope. */
export interface Status {
  /** Whether it lately omitted steps that were due, since they take longer than `rate` allows on the cores that it gets. */
  behind_rate?: boolean;
  /** The accuracy of the state. */
  certificate: Certificate;
  /** The same conditions: their ids, actions and clients; left out without any. */
  conditions?: WaitingCondition[];
  /** Number of controllers that have joined. */
  controllers?: number;
  /** The time step, body sizes over free speed. */
  dt: number;
  /** The earlier versions of the model that computed steps of it or of what it was made from, since their start or reset, oldest first; left out without any. */
  earlier_models?: EarlierModel[];
  /** What went wrong, if it has faulted; left out otherwise. */
  fault?: Fault | null;
  /** The oldest stored checkpoint; `null` while it cannot be read. */
  history_from: HistoryFrom | null;
  /** Number of informed individuals. */
  informed: number;
  /** The size of the group. */
  n: number;
  /** Order and drift. */
  order: Order;
  /** What it was made from; left out if it was created from a spec, and for swarms made by earlier versions. */
  origin?: Origin | null;
  /** The parameters that `set` can change. */
  parameters: ParameterValues;
  /** Whether `protect` protects it from `delete` and `reset`. */
  protected?: boolean;
  /** How many states a second it publishes at most while it runs: what `rate`, `dt` and `publish_every` ask for, or the daemon's `max_hz` if that is less; left out for a playback and in replies of earlier daemons. */
  published_hz?: number | null;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The rate that it reached lately; `null` while it does not run. */
  real_time_factor: number | null;
  /** Why it is paused or faulted. */
  reason: string | null;
  /** The position, if it is a playback. */
  replay?: Replay | null;
  /** Number of commands that wait for their step. */
  scheduled: number;
  /** The seed of all random draws. */
  seed: number;
  /** BLAKE3 of the state, in hexadecimal; zeros for a replay, which has frames and no state. */
  state_hash: string;
  /** The number of the swarm in the store of its daemon: another swarm that gets this name later has another one. Left out for a replay. */
  swarm_id?: number | null;
  /** The step it will pause at; `null` if it has no end. */
  until_step: number | null;
  /** The fraction of the history that a running `verify` has replayed, 0 to 1; `null` if none is running. */
  verifying?: number | null;
  /** The controllers that the swarm waits for in lock-step. */
  waiting_for?: Awaited[];
  /** The conditions for which clients wait by `get/wait`; left out without any. They are no part of the state. */
  waits?: WaitingClient[];
  /** The conditions that it waits for, in the order of their commands; left out without any. See `when`. */
  when?: string[] | null;
}

/** The reply to `step`. */
export interface StepResult {
  /** The last step that a crash of the daemon would not take back. It follows `step` within a few milliseconds, unless the disk is full. */
  durable_step?: number;
  /** The state after the steps, if requested. A retry of the request gets the cached reply, which has no state if the first one took more than 4 KiB: the reply is then JSON. */
  state?: State | null;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
  /** Number of steps that were taken; fewer than requested if another command interrupted them. */
  steps: number;
}

/** What a contact limits. */
export type Stepping = "position" | "velocity";

/** The database of a daemon. */
export interface StoreMetrics {
  /** Seconds that they took, with their syncs. */
  commit_secs: number;
  /** Number of commits since the daemon started. */
  commits: number;
  /** Bytes on disk. */
  disk_bytes: number;
  /** Whether writing fails for another reason. */
  failing: boolean;
  /** Whether the disk is full. */
  full: boolean;
  /** Seconds that the last one took. */
  last_commit_secs: number;
  /** Whether the queue exceeds its memory limit. */
  overrun: boolean;
  /** Number of queued writes. */
  waiting: number;
}

/** A condition for which the swarm waits. */
export interface StoredCondition {
  /** The step of its command; its measures do not use earlier states. */
  first?: number;
  /** The command `when`. */
  sent: Sent;
  /** The step since which each comparison of the condition has held, in the order of the text; `null` for one that does not hold. */
  since: (number | null)[];
}

/** Sums over steps, from which the means are made. */
export interface Sums {
  /** How many steps. */
  count: number;
  /** How many of them had a common direction. */
  directed: number;
  /** Their drifts. */
  drift: number;
  /** Their orders. */
  order: number;
  /** Their velocities. */
  velocity: [number, number];
}

/** Metrics of a swarm. */
export interface SwarmMetrics {
  /** Number of contacts of the last step. */
  contacts: number;
  /** Number of steps that missed the target residual, but were acceptable. */
  degraded: number;
  /** Number of these steps that had a due time. */
  due_steps: number;
  /** Number of failed steps. */
  faults: number;
  /** Seconds that they began after their due times. */
  late_secs: number;
  /** The size of the group. */
  n: number;
  /** The phase of the swarm. */
  phase: Phase;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The rate that it reached lately; `null` while it does not run. */
  real_time_factor: number | null;
  /** Residual of the last step, body sizes. */
  residual: number;
  /** Number of steps since the start. */
  step: number;
  /** Seconds that these steps took. */
  step_secs: number;
  /** Number of steps since the daemon loaded it. */
  steps: number;
  /** The swarm's name. */
  swarm: string;
}

/** A swarm in the list of a daemon. */
export interface SwarmSummary {
  /** The other daemon that has a swarm of this name, if there is one; see `contested`. */
  contested_by?: string | null;
  /** As in its status. */
  earlier_models?: EarlierModel[];
  /** How many individuals are informed. */
  informed: number;
  /** The number of individuals. */
  n: number;
  /** The polar order parameter, 0 to 1. */
  order: number;
  /** As in its status. */
  origin?: Origin | null;
  /** Its phase. */
  phase: Phase;
  /** As in its status. */
  protected?: boolean;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The rate that was reached lately; `null` while it does not run. */
  real_time_factor: number | null;
  /** Why it is paused or faulted. */
  reason: string | null;
  /** Whether it is the playback of a recording. */
  replay?: boolean;
  /** The number of steps since the start. */
  step: number;
  /** Its name. */
  swarm: string;
  /** As in its status. */
  swarm_id?: number | null;
  /** `step · dt`, body sizes over free speed. */
  time: number;
}

/** The swarms of a daemon. */
export interface Swarms {
  /** The swarms, ordered by name. */
  swarms: SwarmSummary[];
}

/** The usual values of a parameter, for a slider. They are those of the paper where it varies one, else around its value; others are valid, too. */
export interface Usual {
  /** The least. */
  from: number;
  /** How they are spread. */
  scale: Scale;
  /** The largest. */
  to: number;
}

/** The result of a replay of a swarm's history. */
export interface Verified {
  /** The first step whose hash differs; `null` if there is none. */
  differs_at: number | null;
  /** The epoch of that step: a reset restarts the count of steps. */
  differs_in_epoch: number | null;
  /** The step of the checkpoint that it began at. */
  from_step: number;
  /** Number of hashes that were compared: those in the history, and the present one of a paused swarm. */
  hashes: number;
  /** The step that it ended at. */
  to_step: number;
}

/** A command that waits for its step. */
export interface Waiting {
  /** The step. */
  at_step: number;
  /** The number of its entry in the journal. */
  line: number;
  /** The command. */
  sent: Sent;
}

/** What a swarm does once a condition holds. */
export type WaitingAction = "pause" | "commands" | "event";

/** A client that waits for a condition by `get/wait`. */
export interface WaitingClient {
  /** The condition. */
  condition: string;
  /** The user; `null` on a daemon without users. */
  user: string | null;
}

/** A condition of `when` that waits. */
export interface WaitingCondition {
  /** `pause`, `commands` or `event`. */
  action: WaitingAction;
  /** The client that sent it, as the request names it; `null` if it is not known. */
  client: string | null;
  /** The condition. */
  condition: string;
  /** False if the condition does not hold since its measures need too much time or too many earlier states: the group has grown, or an earlier version accepted more of them. Left out if it is evaluated. */
  evaluated?: boolean;
  /** The name of its event; left out without one. */
  event?: string | null;
  /** By which `when` with `cancel` removes it: 8 hexadecimal digits, the same for equal conditions with equal actions. */
  id: string;
}

/** The reply to `when`. */
export interface WhenResult {
  /** With `event`: whether the condition holds already, so that it does not wait; left out if it waits. */
  holds?: boolean;
  /** The id of the condition that waits now, by which `when` with `cancel` removes it; left out if none does, and in replies of earlier daemons. */
  id?: string | null;
}

/** The person and role that a daemon assigns to a client, by the token of the query. */
export interface WhoAmI {
  /** The permitted commands of the daemon. */
  node_verbs: string[];
  /** The person; `null` from a daemon without users, and for an unknown token. */
  person: string | null;
  /** The role; `null` for an unknown token. */
  role: Role | null;
  /** The permitted commands of swarms. */
  verbs: string[];
}
