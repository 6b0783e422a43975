// Written by `cargo run --release -p jostle-contract`; not by hand.

/** What a daemon sends. A newer one may send more, and fields with `?` may be missing. */

/** The result of `advance`. */
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
  /** Grows whenever `step` does not continue what was published before. */
  epoch: number;
  /** The phase of the swarm after it. */
  phase: Phase;
  /** The result. */
  result: T;
  /** Counts the swarm's applied commands. */
  seq: number;
  /** The step at which the command was executed; for `step`, the last step. */
  step: number;
  /** The swarm's name. */
  swarm: string;
  /** `step · dt`. */
  time: number;
}

/** The zenoh attachment of a published state, in CBOR: when its step was taken and when it was published, and the newest set-points in it. It is no part of the state, so that equal states have equal bytes. Times are those of the daemon's wall clock, in nanoseconds since 1970, UTC. If that clock is set back in between, the second one is the earlier. */
export interface Attachment {
  /** When the daemon put the state on its key; `null` in a recording by the daemon, which contains states that are not published. */
  published_unix_nanos: number | null;
  /** The `sequence` of the newest set-points that the state contains, by controller: of those in mode `free_running` whose set-points hold. An `advance` has no such number. */
  sequences: Record<string, number>;
  /** When the step that led to the state was taken; `null` if the daemon does not know: before the first step, after a `reset` or a restart until the next one, and in a playback. */
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

/** A node's reply to `get/audit`: who sent which commands, oldest first. */
export interface Audit {
  /** How many of the selected lines are damaged: they are left out. */
  damaged: number;
  /** The lines that the request selects, as many as one reply holds. */
  lines: AuditLine[];
  /** The number of the newest line; 0 before the first. */
  newest: number;
  /** The number of the oldest line that the daemon still has; `null` if it has none. */
  oldest: number | null;
}

/** Equal commands of one client within a minute. */
export interface AuditLine {
  /** What an `experiment`, `record` or `replay` does, such as `cancel`; `null` for other verbs. */
  action: string | null;
  /** What the client calls itself; `null` if it does not. */
  client: string | null;
  /** How many commands there were. */
  count: number;
  /** The same for the last one. */
  last_unix_secs: number;
  /** The swarm, experiment or recording; of `create`, `restore` and `replay` the new swarm. */
  name: string | null;
  /** Counts the lines of the daemon. */
  number: number;
  /** How the commands ended. What is missing to `count` had no outcome when the line was stored. */
  outcomes: AuditOutcome[];
  /** The daemon's wall clock when the first command was received: seconds since 1970, UTC. */
  unix_secs: number;
  /** The user of the token; `null` from a daemon without users, and for an unknown token. */
  user: string | null;
  /** The verb. */
  verb: string;
}

/** How commands ended. */
export interface AuditOutcome {
  /** How many commands ended so. */
  count: number;
  /** `ok`, the code of the error, or `abandoned` of a command that ended because its client was gone. */
  outcome: string;
}

/** A controller that the others wait for. */
export interface Awaited {
  /** Its name. */
  controller: string;
  /** The timeout of this wait, seconds. */
  deadline_secs: number;
  /** For how long, seconds. */
  secs: number;
}

/** The results of the changes in a `batch`, in their order. */
export interface BatchResult {
  /** One for each. */
  results: Changed[];
}

/** How exact a state is. */
export interface Certificate {
  /** How many contacts constrained the step. */
  contacts: number;
  /** How many pairs have crossing axes, measured apart from the solver. */
  crossed: number;
  /** How many steps since the start or reset were taken with a larger residual. */
  degraded: number;
  /** How many iterations the solver took. */
  iterations: number;
  /** The residual of the step that led here, in body sizes: at most 1e-9 unless degraded. */
  residual: number;
  /** The smallest gap between two bodies, measured apart from the solver; negative is overlap; `null` if no two are near. */
  worst_gap: number | null;
}

/** The result of a change. */
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
  /** How long others wait for it, or how long its set-points hold, seconds. */
  deadline_secs: number;
  /** Whether it may drive individuals directly. */
  driving: boolean;
  /** The individuals that it steers, by id. */
  ids: number[];
  /** Deadlines missed in a row. */
  misses: number;
  /** When the swarm steps. */
  mode: Mode;
  /** What happens to its individuals when it is late. */
  on_timeout: OnTimeout;
  /** The outcomes of its puts. */
  puts: Puts;
  /** The step that it has advanced to; `null` unless in lock-step. */
  target_step: number | null;
  /** For how long others have waited for it, seconds; `null` if they do not. */
  waited_secs: number | null;
}

/** A swarm's reply to `get/controllers`. */
export interface ControllerList {
  /** The joined controllers, by name. */
  controllers: Controller[];
}

/** The result of `create`. */
export interface CreateResult {
  /** False if an equal swarm existed. */
  created: boolean;
  /** The spec with every default filled in. */
  spec: Spec;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
}

/** A controller that has left. */
export interface Departed {
  /** The controller. */
  controller: string;
  /** Why. */
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

/** The result of a command without one. */
export type EmptyResult = Record<string, unknown>;

/** The error reply to a request. Clients branch on `code`; `message` has the remedy. */
export interface ErrorBody {
  /** The kind. */
  code: ErrorCode;
  /** For programs: such as `field` and `range`. */
  details?: Record<string, unknown>;
  /** For people: what is wrong, and the remedy. */
  message: string;
  /** The current step of the swarm; `null` if the request is not to a swarm. */
  step?: number | null;
}

/** The kinds of errors. */
export type ErrorCode = "not_found" | "already_exists" | "invalid_argument" | "incorrect_state" | "resource_exhausted" | "busy" | "conflict" | "contested" | "permission_denied" | "storage_full" | "deadline_exceeded" | "faulted" | "internal";

/** A published event. A gap in the numbers shows a reader that it missed some. */
export interface EventMessage {
  /** Grows whenever `step` does not continue what was published before. */
  epoch: number;
  /** What happened. */
  event: EventKind;
  /** Counts the swarm's events from 1. */
  number: number;
  /** The phase of the swarm after it. */
  phase: Phase;
  /** The step at which it happened. */
  step: number;
  /** The swarm's name. */
  swarm: string;
  /** `step · dt`. */
  time: number;
  /** The daemon's wall clock when it happened: seconds since 1970, UTC, to the millisecond; `null` if it is not known. */
  unix_secs?: number | null;
}

/** What happened. */
export type EventKind = {
  /** The client, as the request names it. */
  client?: string | null;
  kind: "created";
  /** The id that its client gave it. */
  request_id?: string | null;
  /** The verb that created it: `create`, `restore`, `fork` or `replay`; `null` if it is not known, as for a swarm that an earlier version created. */
  verb?: string | null;
} | {
  kind: "phase";
  /** Why. */
  reason: string | null;
} | {
  /** Its arguments as received. */
  args: unknown;
  /** The client, as the request names it. */
  client: string | null;
  kind: "command";
  /** The id that its client gave it. */
  request_id: string | null;
  /** Counts the swarm's applied commands. */
  seq: number;
  /** Its verb. */
  verb: string;
} | {
  /** The step at which it will be executed. */
  applies_at_step: number;
  /** Its arguments as received. */
  args: unknown;
  /** The client, as the request names it. */
  client: string | null;
  kind: "scheduled";
  /** The id that its client gave it. */
  request_id: string | null;
  /** Its verb. */
  verb: string;
} | {
  /** Its arguments as received. */
  args: unknown;
  /** The client, as the request names it. */
  client: string | null;
  /** Why. */
  error: ErrorBody;
  kind: "refused";
  /** The id that its client gave it. */
  request_id: string | null;
  /** Its verb. */
  verb: string;
} | {
  /** Their ids, ascending. */
  ids: number[];
  kind: "lapsed";
} | {
  kind: "fault";
  /** Why. */
  reason: string;
} | {
  kind: "recording_failed";
  /** Why. */
  reason: string;
  /** The recording's name. */
  recording: string;
} | {
  /** The client, as the request names it. */
  client?: string | null;
  kind: "deleted";
  /** The id that its client gave it. */
  request_id?: string | null;
};

/** A swarm's reply to `get/events?after=NUMBER`: the events it still has, oldest first. */
export interface Events {
  /** Those after the requested number, as many as one reply holds. */
  events: EventMessage[];
  /** The number of the newest one: query until it is reached. 0 before the first. */
  newest: number;
  /** The number of the oldest one that it still has; `null` if it has none. */
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
  /** How many steps the run takes, at most. */
  steps: number;
  /** The condition that ends the run and pauses the swarm; `null` if there is none. */
  stop: string | null;
}

/** The commands of a swarm since its start, as the file of an experiment with one run. The parameter `replicates` of the query gives the run other seeds, so many. The file contains the set-points of controllers as the text of a CSV; with the parameter `setpoints`, a name of a file, it names that one. */
export interface ExperimentFile {
  /** The text of the file, TOML. Its run takes the steps of the swarm. */
  file: string;
  /** The text of the CSV of set-points that the file names, with the parameter `setpoints`; left out if no controller steered an individual. */
  setpoints?: string | null;
  /** BLAKE3 of the state at that step, in hexadecimal. The run ends with it, unless commands were applied at that step: then the run takes one more step. */
  state_hash: string;
  /** The step of the swarm. */
  steps: number;
}

/** What an experiment is doing. */
export type ExperimentPhase = "queued" | "running" | "paused" | "finished" | "cancelled" | "failed";

/** What a node did with an experiment. */
export interface ExperimentResult {
  /** Whether it was not there before. */
  created: boolean;
  /** The run of `expand`. */
  expanded?: ExpandedRun | null;
  /** How it stands now; of a deleted one, how it stood; with `expand`, how it would begin. */
  progress: Progress;
}

/** A node's answer to `get/experiments`. */
export interface Experiments {
  /** All it has, in the order in which they were submitted. */
  experiments: Progress[];
}

/** The value of a column that only some experiments have, in one row: a variable of the grid, `stopped_at`, or the mean of a chosen measure. */
export interface ExtraValue {
  /** The name of the column. */
  name: string;
  /** The value; `null` if it is undefined. */
  value: number | null;
}

/** What went wrong in a swarm that has faulted. `reason` says it in words. */
export interface Fault {
  /** The gap between the two bodies that cross, in the last good state, body sizes; `null` for others. */
  gap: number | null;
  /** The individuals that it is about; empty if it is about none in particular. */
  ids: number[];
  /** What it is. */
  kind: FaultKind;
}

/** What went wrong. */
export type FaultKind = "crossed_bodies" | "not_solved" | "overturned" | "not_finite" | "other";

/** A node's reply to `get/hello`: its version and limits. */
export interface Hello {
  /** Its data, by a number that the daemon drew when it began their database. A daemon with the same id has the replies to commands that were executed, so that a command can be sent again after a restart. Absent if the daemon could not store it. */
  data_id?: string | null;
  /** Where it serves HTTP, such as `https://0.0.0.0:8443`; absent if it serves none. */
  http?: string | null;
  /** The limits it enforces. */
  limits: Limits;
  /** The daemon's clock: seconds since 1970, UTC. */
  unix_secs: number;
  /** The daemon's version. */
  version: string;
  /** The version of the contract. */
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

/** The oldest stored checkpoint of a swarm: all after it can be replayed. */
export interface HistoryFrom {
  /** Its epoch. */
  epoch: number;
  /** Its step. */
  step: number;
}

/** The individuals that a command changed. */
export interface IdsResult {
  /** Their ids, ascending. */
  ids: number[];
  /** The size of the group now. */
  n: number;
}

/** The result of `join`. */
export interface JoinResult {
  /** The individuals that it steers, by id. */
  ids: number[];
  /** What happened while it was away, if it joins again. */
  news: News;
}

/** A swarm's reply to `get/journal?after=SEQ`: the commands it applied, oldest first. The spec and these commands determine the state of the swarm. */
export interface Journal {
  /** Those after the requested `seq` that the request selects, as many as one reply holds. */
  entries: JournalEntry[];
  /** The `seq` of the newest one. 0 before the first. */
  newest: number;
  /** The line of the journal at which the next page begins: query again with it as `line`, also if this page has no entries. Left out by the last page. */
  next?: number | null;
  /** The `seq` of the oldest one that it still has; `null` if it has none. */
  oldest: number | null;
}

/** A command that was applied. */
export interface JournalEntry {
  /** Its arguments as received. */
  args: unknown;
  /** The client, as the request names it. */
  client: string | null;
  /** The epoch it was applied in. */
  epoch: number;
  /** The id that its client gave it. */
  request_id: string | null;
  /** Counts the swarm's applied commands; a `batch` counts each of its changes, and has the number of the last. */
  seq: number;
  /** The step it was applied at. */
  step: number;
  /** `step · dt`. */
  time: number;
  /** The daemon's wall clock when it was applied: seconds since 1970, UTC, to the millisecond; `null` if it is not known, as in what older versions journaled. */
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
  /** Clients at once; while more are connected, `get/hello` is rejected. */
  max_clients: number;
  /** States published per second and swarm. */
  max_hz: number;
  /** Individuals in one swarm. */
  max_individuals: number;
  /** Memory of all swarms together, in bytes. */
  max_memory_bytes: number;
  /** The longest request, in bytes; a longer one is rejected, and zenoh drops one of more than 1 MiB without an error. */
  max_message_bytes: number;
  /** Swarms at once. */
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

/** A swarm's reply to `get/measures?names=NAME,...`, or with a histogram to `get/measures?histogram=NAME;bins=COUNT;max=LENGTH`. */
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

/** A node's answer to `get/metrics`. What grows for ever is counted since the daemon started; two looks tell what came in between. */
export interface Metrics {
  /** Names of the daemon and its swarms that another daemon holds, too. */
  contested?: number;
  /** Cores it may use. */
  cores: number;
  /** Seconds its threads have computed. */
  cpu_secs: number;
  /** Steps that missed the target residual, yet were good enough to go on. */
  degraded: number;
  /** What all experiments take on disk, in bytes; earlier daemons do not count it. */
  experiments_bytes?: number | null;
  /** What they may take, in bytes: the one that goes on is paused there, and none begins; `null` if they may take the whole disk. */
  experiments_quota_bytes?: number | null;
  /** Steps that failed; each stops its swarm. */
  faults: number;
  /** States made to be published. */
  frames: number;
  /** States that gave way to a newer one before they were published. */
  frames_dropped: number;
  /** Memory in use, in bytes. */
  memory_bytes: number;
  /** The recordings it has made or makes. */
  recordings?: RecordingMetrics;
  /** What all recordings take on disk, in bytes. */
  recordings_bytes?: number;
  /** What they may take, in bytes: those that go on end there, and none begins. */
  recordings_quota_bytes?: number;
  /** The largest residual of a step, in body sizes. */
  residual_max: number;
  /** Clients connected. */
  sessions: number;
  /** Seconds that these steps took. */
  step_secs: number;
  /** Steps taken by all swarms there ever were. */
  steps: number;
  /** How the daemon's memory on disk does. */
  store: StoreMetrics;
  /** Every swarm, ordered by name. */
  swarms: SwarmMetrics[];
  /** Why not all is well, for people; empty if it is. */
  unwell: string[];
  /** Seconds since the daemon started. */
  uptime_secs: number;
  /** What is wrong without keeping it from its work, such as a recording that has failed, for people; empty if nothing is. */
  warnings?: string[];
}

/** A missed deadline. */
export interface Miss {
  /** The late controller. */
  controller: string;
  /** How many it has missed in a row; the third removes it. */
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
  /** Missed deadlines, its own too. */
  missed: Miss[];
  /** Individuals of its own that were removed. */
  removed: number[];
}

/** The reply of a node. */
export interface NodeReply<T> {
  /** The node's name. */
  node: string;
  /** The result. */
  result: T;
}

/** A node's reply to `get/status`. */
export interface NodeStatus {
  /** Clients connected. */
  clients: number;
  /** Of it, memory reserved for that experiment, in bytes. */
  experiments_memory_bytes?: number;
  /** How many of them faulted. */
  faulted: number;
  /** Individuals in all swarms together. */
  individuals: number;
  /** Memory reserved for the swarms and the experiment that goes on, in bytes. */
  memory_bytes: number;
  /** How many of them run. */
  running: number;
  /** Swarms it hosts. */
  swarms: number;
  /** Seconds since the daemon started. */
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

/** How ordered a swarm is and where it drifts, now and on average since the start or reset. Speeds are in free speeds; the means are over steps. */
export interface Order {
  /** The informed individuals' common direction in radians, that of the sum of their directions, each times its weight; `null` if none is informed, or `direction_strength` is below 0.1. */
  direction: number | null;
  /** How far the informed individuals agree: the length of that sum, divided by the sum of the weights, 0 to 1; `null` if none is informed, or in a recording of an earlier version. */
  direction_strength?: number | null;
  /** The velocity along that direction. */
  drift: number | null;
  /** Its mean over the steps that had such a direction. */
  mean_drift: number | null;
  /** Its mean; `null` before the first step. */
  mean_order: number | null;
  /** Its mean; `null` before the first step. */
  mean_velocity: [number, number] | null;
  /** The polar order parameter, eq. (8) without the mean: 0 to 1. */
  order: number;
  /** The centroid's velocity, which is the mean heading. */
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

/** One published order. */
export interface OrderSample {
  /** How exact the state is. */
  certificate: Certificate;
  /** Grows whenever `step` does not continue what was published before. */
  epoch: number;
  /** The number of the state it goes with. */
  frame: number;
  /** How many individuals are informed. */
  informed: number;
  /** The measures that the swarm publishes, by name, each in its unit; `null` where one is undefined or the group is too large for it. Left out without any. */
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
  /** `step · dt`. */
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

/** A parameter of a swarm, described for a form or a slider. */
export interface Parameter {
  /** The verbs that change it. */
  changed_by: string[];
  /** The values of a choice, of those that take numbers the kind alone; empty otherwise. */
  choices: unknown[];
  /** The value if left out; `null` if it is required. */
  default: unknown;
  /** What it means, in a line. */
  doc: string;
  /** The value that it must exceed; `null` if there is none. */
  exclusive_minimum: number | null;
  /** What values it takes. */
  kind: ParameterKind;
  /** Whether commands can change it. */
  live: boolean;
  /** The largest value at present; `null` if there is none. */
  maximum: number | null;
  /** The least value; `null` if there is none. */
  minimum: number | null;
  /** Its name in the spec. */
  name: string;
  /** Whether `null` is a value. */
  nullable: boolean;
  /** Its unit; `1` if it has none. */
  unit: string;
  /** What it usually is; `null` of a parameter without such a range, and of daemons of earlier versions. */
  usual?: Usual | null;
  /** The current value. */
  value: unknown;
}

/** What values a parameter takes. */
export type ParameterKind = "number" | "integer" | "choice";

/** The values of the parameters that commands can change. */
export interface ParameterValues {
  /** What an individual turns towards. */
  attraction: Attraction;
  /** Which of a pair's contacts constrain it. */
  contacts: ContactRule;
  /** For how many seconds the swarm waits for a controller in lock-step that sends nothing; left out without a limit. */
  max_idle_secs?: number | null;
  /** The measures in each published order; left out without any. */
  measures?: string[] | null;
  /** Intensity of white noise on the turning rate, squared angle over time: 0 or more. */
  noise: number;
  /** Length over width of a body: 1 (a disc) to 32. */
  pi1: number;
  /** Weight of the preferred direction of individuals informed without a weight: 0 or more. */
  pi2: number;
  /** Body size over turning radius: above 0. */
  pi3: number;
  /** Translational over rotational drag: above 0. */
  pi4: number;
  /** Steps between two published states: 1 or more. */
  publish_every: number;
  /** How many more programs a step solves about what the last one predicts: 0 or 1. One more leaves less overlap, and goes with `position` alone. */
  relinearise: number;
  /** What a contact limits. */
  stepping: Stepping;
}

/** A swarm's reply to `get/parameters`. */
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

/** How far an experiment is. Published while it changes, at most twice a second. */
export interface Progress {
  /** How long it has been running, pauses aside. */
  elapsed_secs: number;
  /** How many of them ended early. */
  faulted: number;
  /** How many are over. */
  finished: number;
  /** The estimated time to its end without pauses; `null` while unknown. */
  left_secs: number | null;
  /** Why it failed; what it waits for. */
  message: string | null;
  /** The experiment's name. */
  name: string;
  /** What it is doing. */
  phase: ExperimentPhase;
  /** The runs under way. */
  running: RunUnderWay[];
  /** How many runs it has. */
  runs: number;
  /** The share of the work that is done, the work of runs under way included. */
  share: number;
}

/** The outcomes of a controller's puts. */
export interface Puts {
  /** Applied. */
  applied: number;
  /** Overtaken by a newer one before the next step. */
  overtaken: number;
  /** Unreadable, out of range, not permitted, or about individuals that are not its own. */
  refused: number;
  /** Not newer than one before, or of another epoch. */
  stale: number;
}

/** A state, as a recording counts. */
export interface RecordedAt {
  /** Its epoch. */
  epoch: number;
  /** Its step. */
  step: number;
}

/** How a recording stands; of a deleted one, how it stood. */
export interface Recording {
  /** When it began, in seconds since 1970. */
  began_unix_secs: number;
  /** Their bytes. */
  bytes: number;
  /** Whether it leaves states out while the disk does not keep up. */
  drop_when_behind?: boolean;
  /** The states whose step is a multiple of this are in it; `null`: an earlier version recorded what was published. */
  every: number | null;
  /** How it is written. */
  format: RecordingFormat;
  /** How many states were recorded. */
  frames: number;
  /** Where the last of those were; `null`: none was lost. */
  gap?: RecordingGap | null;
  /** How many of them it lost because the daemon ended before their file was whole. */
  lost?: number;
  /** How many of its finished files are missing or damaged; `frames`, `parts` and `bytes` are those of the others then. */
  lost_parts?: number;
  /** The bytes from which on it ends; `null`: an earlier version began it, without such an end. */
  max_bytes?: number | null;
  /** How many states are missing: those that it left out because the disk did not keep up (without `drop_when_behind` the swarm waits instead), and those in `lost`. */
  missed: number;
  /** How many of its files are whole. */
  parts: number;
  /** What it is doing. */
  phase: RecordingPhase;
  /** Why it ended or failed, and which of its files are missing or damaged. */
  reason: string | null;
  /** Its name, and its folder's below `recordings` in the daemon's data directory. */
  recording: string;
  /** The swarm. */
  swarm: string;
  /** Whether a client is to fetch it and delete it then. */
  temporary?: boolean;
}

/** How a recording is written: as MCAP, unless an earlier version wrote it. */
export type RecordingFormat = "mcap" | "parquet";

/** States that a recording lost when the daemon ended, all of them before the next state in it. */
export interface RecordingGap {
  /** The state up to which none is missing; `null`: the recording begins with the gap. */
  after: RecordedAt | null;
  /** How many states are missing. */
  missed: number;
  /** The state from which on it continues. */
  until: RecordedAt;
}

/** A daemon's recordings, counted by what they do. */
export interface RecordingMetrics {
  /** Those that have ended. */
  ended: number;
  /** Those that have failed. */
  failed: number;
  /** Those that go on. */
  recording: number;
}

/** What a recording is doing. */
export type RecordingPhase = "recording" | "ended" | "failed";

/** A node's answer to `get/recording`: a piece of a file that is whole. */
export interface RecordingPiece {
  /** The piece, as base64: at most 512 KiB of the part; empty where the part ends. */
  bytes: string;
  /** How long the whole part is, in bytes. */
  length: number;
  /** Where in the part the piece begins, in bytes. */
  offset: number;
  /** The number of the part, from 0. */
  part: number;
  /** How many parts are whole now. */
  parts: number;
  /** The recording. */
  recording: string;
}

/** A node's answer to `get/recordings`. */
export interface Recordings {
  /** All it has, ordered by name. */
  recordings: Recording[];
}

/** A playback and its position. */
export interface Replay {
  /** Time units from its first frame to its last, resets and gaps left out. */
  duration: number;
  /** The number of the current frame, from 1. */
  frame: number;
  /** How many frames it has. */
  frames: number;
  /** The swarm that was recorded. */
  of: string;
  /** Time units since its first frame. */
  position: number;
}

/** The result of a command to a playback. */
export interface ReplayResult {
  /** The playback, for `open`. */
  replay: Replay | null;
  /** Uploaded bytes, which is the offset of the next piece. `null` for `open`. */
  uploaded: number | null;
}

/** The result of `reset`. */
export interface ResetResult {
  /** Its seed. */
  seed: number;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
}

/** The result of one run of an experiment: a row of `results.csv`, one member for each column. */
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
  /** Why the run ended early, if a fault ended it; left out otherwise. The other members are then those of the time before the fault. */
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
  /** The columns that only some experiments have, so that a table without rows has them, too. Left out by earlier versions. */
  columns?: OccasionalColumns | null;
  /** How many runs are over by now. */
  finished: number;
  /** The experiment's name. */
  name: string;
  /** Where to ask on, as `after`; `null` if there is no more. */
  next: number | null;
  /** The rows of the runs that are finished, faulted ones included, after the run asked for. */
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

/** How the swarm runs now. */
export interface RunResult {
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The step it will pause at. */
  until_step: number | null;
}

/** A run that is being carried out. */
export interface RunUnderWay {
  /** Its name. */
  run: string;
  /** The share of its steps that is done. */
  share: number;
}

/** How values are spread over a range. */
export type Scale = "linear" | "logarithmic";

/** The result of a command that is scheduled by `at_step`. */
export interface Scheduled {
  /** The step at which it will be executed; an event then has its result. */
  applies_at_step: number;
}

/** A node's reply to `get/schema`: JSON Schemas (2020-12) of every message. */
export interface Schemas {
  /** By the name of the message, such as `step.args`. */
  schemas: Record<string, unknown>;
  /** The version of the contract they describe. */
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

/** The result of `set`. */
export interface SetResult {
  /** The values before. */
  before: ParameterValues;
  /** The values now. */
  now: ParameterValues;
  /** How many states a second it publishes at most while it runs: what `rate`, `dt` and `publish_every` ask for, or the daemon's `max_hz` if that is less. Left out in a `batch`. */
  published_hz?: number | null;
  /** The factor by which positions were scaled to make room; 1 if they were not. */
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
  /** The version of the model that steps it: another one has another future. */
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

/** The description of a swarm: same spec, same seed, same bytes. Lengths are in body sizes, speeds in free speeds, times in their quotient. Everything but `n` may be left out. */
export interface Spec {
  /** What an individual turns towards. */
  attraction?: Attraction;
  /** Which of a pair's contacts constrain it. */
  contacts?: ContactRule;
  /** The time step: above 0, and short enough that a step cannot carry a body across another. */
  dt?: number;
  /** The measures in each published order, such as `milling`, at most 16 that need no earlier state; none if left out. */
  measures?: string[] | null;
  /** The number of individuals: 1 to the daemon's limit; in a spec that at the start. */
  n: number;
  /** Intensity of white noise on the turning rate, squared angle over time: 0 or more. */
  noise?: number;
  /** Length over width of a body: 1 (a disc) to 32. */
  pi1?: number;
  /** Weight of the preferred direction of individuals informed without a weight: 0 or more. */
  pi2?: number;
  /** Body size over turning radius: above 0. */
  pi3?: number;
  /** Translational over rotational drag: above 0. */
  pi4?: number;
  /** Steps between two published states: 1 or more. */
  publish_every?: number;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate?: number | null;
  /** How many more programs a step solves about what the last one predicts: 0 or 1. One more leaves less overlap, and goes with `position` alone. */
  relinearise?: number;
  /** The seed of every draw: 0 to 2⁵³ - 1. */
  seed?: number;
  /** Where the individuals begin. */
  start?: Start;
  /** What a contact limits. */
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

/** A swarm's reply to `get/status`; phase, step and time are in the envelope. */
export interface Status {
  /** Whether it lately omitted steps that were due, since they take longer than `rate` allows on the cores that it gets. */
  behind_rate?: boolean;
  /** How exact the state is. */
  certificate: Certificate;
  /** The same conditions: their ids, actions and clients; left out without any. */
  conditions?: WaitingCondition[];
  /** How many controllers have joined. */
  controllers?: number;
  /** The time step. */
  dt: number;
  /** What went wrong, if it has faulted; left out otherwise. */
  fault?: Fault | null;
  /** The start of its stored history; `null` while that cannot be read. */
  history_from: HistoryFrom | null;
  /** How many individuals are informed. */
  informed: number;
  /** The number of individuals. */
  n: number;
  /** Order and drift. */
  order: Order;
  /** What it was made from; left out if it was created from a spec, and for swarms made by earlier versions. */
  origin?: Origin | null;
  /** The parameters that commands can change. */
  parameters: ParameterValues;
  /** How many states a second it publishes at most while it runs: what `rate`, `dt` and `publish_every` ask for, or the daemon's `max_hz` if that is less. Left out for a replay. */
  published_hz?: number | null;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** The rate that was reached lately; `null` while it does not run. */
  real_time_factor: number | null;
  /** Why it is paused or faulted. */
  reason: string | null;
  /** The position, if it is the playback of a recording. */
  replay?: Replay | null;
  /** Commands that wait for their step. */
  scheduled: number;
  /** The seed of every draw. */
  seed: number;
  /** BLAKE3 of the state, in hexadecimal; zeros for a replay, which has frames and no state. */
  state_hash: string;
  /** The number of the swarm in the store of its daemon: another swarm that gets this name later has another one. Left out for a replay. */
  swarm_id?: number | null;
  /** The step it will pause at. */
  until_step: number | null;
  /** The share of its history that a `verify` under way has replayed, from 0 to 1; `null` if none is under way. */
  verifying?: number | null;
  /** The controllers that the swarm waits for in lock-step. */
  waiting_for?: Awaited[];
  /** The conditions for which clients wait by `get/wait`; left out without any. They are no part of the swarm's state. */
  waits?: WaitingClient[];
  /** The conditions that it waits for, in the order of their commands; left out without any. */
  when?: string[] | null;
}

/** The result of `step`. */
export interface StepResult {
  /** The last step that is durable: a crash of the daemon does not undo it. It follows `step` within a few milliseconds, unless the disk is full. */
  durable_step?: number;
  /** The state after the steps, if requested. A retry of the request gets the cached reply, which has no state if the first one took more than 4 KiB: the reply is then JSON. */
  state?: State | null;
  /** BLAKE3 of the state, in hexadecimal. */
  state_hash: string;
  /** How many steps were taken; fewer than asked for if another command came between. */
  steps: number;
}

/** What a contact limits. */
export type Stepping = "position" | "velocity";

/** How a daemon's memory on disk does. */
export interface StoreMetrics {
  /** Seconds that all commits took, their syncs included. */
  commit_secs: number;
  /** Commits. */
  commits: number;
  /** What it takes on disk, in bytes. */
  disk_bytes: number;
  /** Whether writing fails otherwise. */
  failing: boolean;
  /** Whether the disk is full. */
  full: boolean;
  /** Seconds that the last one took. */
  last_commit_secs: number;
  /** Whether more waits than should be kept in memory. */
  overrun: boolean;
  /** Writes that wait. */
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

/** A swarm in numbers. */
export interface SwarmMetrics {
  /** Contacts of its last step. */
  contacts: number;
  /** Steps that missed the target residual, yet were good enough to go on. */
  degraded: number;
  /** How many of them were due at a time. */
  due_steps: number;
  /** Steps that failed. */
  faults: number;
  /** Seconds that they began after they were due. */
  late_secs: number;
  /** The number of individuals. */
  n: number;
  /** What it is doing. */
  phase: Phase;
  /** Time units per second of wall clock; `null` is as fast as possible. */
  rate: number | null;
  /** Time units per second of wall clock it lately ran at; `null` while it does not run. */
  real_time_factor: number | null;
  /** Residual of its last step, in body sizes. */
  residual: number;
  /** The number of steps since the start. */
  step: number;
  /** Seconds that these steps took. */
  step_secs: number;
  /** Steps taken since it is hosted here. */
  steps: number;
  /** Its name. */
  swarm: string;
}

/** A swarm in a list. */
export interface SwarmSummary {
  /** The other daemon that has a swarm of this name, if there is one; see `contested`. */
  contested_by?: string | null;
  /** How many individuals are informed. */
  informed: number;
  /** The number of individuals. */
  n: number;
  /** The polar order parameter. */
  order: number;
  /** As in its status. */
  origin?: Origin | null;
  /** Its phase. */
  phase: Phase;
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
  /** `step · dt`. */
  time: number;
}

/** A node's reply to `get/swarms`. */
export interface Swarms {
  /** All it hosts, ordered by name. */
  swarms: SwarmSummary[];
}

/** The usual values of a parameter, for a slider: those of the paper where it varies one, else around its value. Others are valid, too. */
export interface Usual {
  /** The least. */
  from: number;
  /** How they are spread. */
  scale: Scale;
  /** The largest. */
  to: number;
}

/** Whether a replay of a swarm's journal gives the same hashes. */
export interface Verified {
  /** The first step with a different hash; `null` if there is none. */
  differs_at: number | null;
  /** The epoch of that step: a reset restarts the count of steps. */
  differs_in_epoch: number | null;
  /** The step of the checkpoint from which it was replayed. */
  from_step: number;
  /** How many hashes were compared: those in the journal, and the current one of a swarm that is paused. */
  hashes: number;
  /** The step to which it was replayed. */
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
  /** What the swarm does once it holds. */
  action: WaitingAction;
  /** The client that sent it, as the request names it; `null` if it does not. */
  client: string | null;
  /** The condition. */
  condition: string;
  /** Whether it is evaluated, left out if it is. If not, it does not hold: the group has grown, or an earlier version accepted more conditions, so that their measures need too much time or too many earlier states. */
  evaluated?: boolean;
  /** The name of its event; left out without one. */
  event?: string | null;
  /** By which `when` with `cancel` removes it: 8 hexadecimal digits, the same for equal conditions with equal actions. */
  id: string;
}

/** The result of `when`. */
export interface WhenResult {
  /** With `event` and `from_step`: whether the condition holds in the present state. It does not wait then. */
  holds?: boolean;
  /** The id of the condition that waits now, by which `when` with `cancel` removes it; left out if none does. Daemons of earlier versions leave it out. */
  id?: string | null;
}

/** A daemon's answer to `get/whoami`, which goes by the token that the query brings along. */
export interface WhoAmI {
  /** What they may have the daemon execute. */
  node_verbs: string[];
  /** The name; `null` from a daemon without users, and for an unknown token. */
  person: string | null;
  /** The role; `null` for an unknown token. */
  role: Role | null;
  /** What they may have swarms execute. */
  verbs: string[];
}
