// Written by `cargo run --release -p jostle-contract`; not by hand.

/** What a daemon receives; it rejects unknown fields. */

/** Permits steps of the swarm, which takes them when every controller has, and then replies. `expect_step` of the envelope is the step at which the controller assumes the swarm. */
export interface AdvanceArgs {
  /** The controller's name. */
  controller: string;
  /** What the reply contains. */
  return?: Return;
  /** Set-points from the next step on; individuals without one keep theirs. */
  set?: SetPoints | null;
  /** How many steps: 1 to 10⁹. */
  steps?: number;
}

/** Writes a note into the journal and the events of a swarm, in every phase. The note changes neither the state nor the random draws of later commands. */
export interface AnnotateArgs {
  /** The note: 1 to 1000 characters in one line, without control characters. */
  text: string;
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

/** Applies all of several changes at one step, or none. */
export interface BatchArgs {
  /** 1 to 256 of them, applied in this order as if each had been sent alone. */
  commands: Change[];
  /** Seeds the draws of the first command together with the swarm's seed, instead of its `seq`; each further command adds 1. */
  draw?: number | null;
  /** The command is part of a protocol: without `draw`, the number of the swarm's changes so far by such commands seeds the draws, plus 1. The changes of commands with `draw` do not count. */
  protocol?: boolean;
}

/** What to record. */
export interface BeginRecordingArgs {
  /** Leave states out, and count them, while the disk does not keep up; otherwise the swarm waits for the disk. */
  drop_when_behind?: boolean;
  /** Record the states whose step is a multiple of this, each of them; the swarm's `publish_every` if left out. */
  every?: number | null;
  /** `mcap` or left out. Clients of earlier versions send it; `parquet` is rejected. */
  format?: string | null;
  /** End when the files have so many bytes; 1 GiB if left out. */
  max_bytes?: number | null;
  /** What to call it; the swarm's name and a number if left out. */
  recording?: string | null;
  /** End when the swarm has taken so many steps. */
  steps?: number | null;
  /** The swarm. */
  swarm: string;
  /** A client is to fetch it and delete it then. The daemon itself deletes none. */
  temporary?: boolean;
}

/** A verb that changes parameters or the group, with its arguments. */
export type Change = {
  args: SetArgs;
  verb: "set";
} | {
  args: InformArgs;
  verb: "inform";
} | {
  args: UninformArgs;
  verb: "uninform";
} | {
  args: InjectArgs;
  verb: "inject";
} | {
  args: RemoveArgs;
  verb: "remove";
};

/** Which of a pair's contacts constrain it. */
export type ContactRule = "endpoints" | "closest" | "clamped";

/** Set-points that a controller puts on `ctl/{controller}` while the swarm runs, as JSON or CBOR. They apply at the next step; the newest wins. */
export interface Control {
  /** The epoch for which it is meant; in another one it is stale. */
  epoch?: number | null;
  /** Grows with every put: one that is not larger than the last is stale and dropped. */
  sequence: number;
  /** The set-points. */
  set: SetPoints;
}

/** Creates a swarm; sent to a node. The swarm is created paused. */
export interface CreateArgs {
  /** Whether a swarm of that name with an equal spec is a success. */
  exist_ok?: boolean;
  /** The new swarm's name. */
  name: string;
  /** Its spec. */
  spec: Spec;
}

/** Deletes a swarm. */
export type DeleteArgs = Record<string, never>;

/** Deletes one daemon's swarm. Sent to the node: a swarm's key may reach several daemons. */
export interface DiscardArgs {
  /** The swarm's name. */
  name: string;
}

/** A run of an experiment that need not be submitted. */
export interface ExpandArgs {
  /** The contents of the CSV that `points` in the file names. */
  points?: string | null;
  /** The run, by its name or by its number in the plan, from 1; the first one if left out. */
  run?: string | null;
  /** The contents of the CSV that `setpoints` in the file names. */
  setpoints?: string | null;
  /** The contents of the snapshot that `start` in the file names, its CBOR as base64. */
  start?: string | null;
  /** The file that describes the experiment, TOML. */
  toml: string;
}

/** A command to an experiment; sent to a node. */
export type ExperimentArgs = {
  submit: SubmitArgs;
} | {
  pause: ExperimentName;
} | {
  resume: ExperimentName;
} | {
  cancel: ExperimentName;
} | {
  delete: ExperimentName;
} | {
  expand: ExpandArgs;
};

/** Which experiment. */
export interface ExperimentName {
  /** Its name. */
  name: string;
}

/** The `count` individuals furthest along a direction. */
export interface Foremost {
  /** The direction in radians, counter-clockwise from +x. */
  along: number;
  /** How many. */
  count: number;
}

/** Creates a copy of a swarm, paused: both have the same states until they get different commands. */
export interface ForkArgs {
  /** The new swarm's name. */
  name: string;
  /** Copies the swarm as it was when it reached this step of its current epoch, before the commands at that step; left out, as it is now. */
  step?: number | null;
}

/** Gives individuals a direction of their own. */
export interface InformArgs {
  /** Their preferred direction in radians, counter-clockwise from +x. */
  direction: number;
  /** The time after which they are uninformed again, body sizes over free speed; for good if left out. */
  for_time?: number | null;
  /** The individuals; draws are from all. */
  select: Select;
  /** The weight of that direction beside attraction: above 0; `pi2` if left out. */
  weight?: number | null;
}

/** Adds individuals, informed or not, where they overlap no other one. One of `count` and `at`. */
export interface InjectArgs {
  /** Their poses. */
  at?: Pose[] | null;
  /** Their number, at the border of the group, or in `within`. */
  count?: number | null;
  /** Informs them: their preferred direction in radians, counter-clockwise from +x. */
  direction?: number | null;
  /** With `direction`: its weight beside attraction; `pi2` if left out. */
  weight?: number | null;
  /** With `count`: the disc in which they are drawn, absolute centre and radius in body sizes. */
  within?: Region | null;
}

/** Registers a controller of a swarm, and claims individuals that no other controller may steer. In lock-step the swarm steps when every controller has advanced. */
export interface JoinArgs {
  /** Whether it joins again: it replaces the controller of its name. */
  again?: boolean;
  /** Its name, which identifies it in further requests. */
  controller: string;
  /** In lock-step, how long others wait for it; running freely, how long its set-points hold after the last put. Seconds: above 0, at most 60. */
  deadline_secs?: number;
  /** Whether it may drive individuals directly, by turning rate and speed. Beyond the paper. */
  driving?: boolean;
  /** When the swarm steps. */
  mode?: Mode;
  /** What happens to its individuals when it is late. In lock-step the swarm then continues without it, and removes it after three misses in a row. */
  on_timeout?: OnTimeout;
  /** The individuals to steer; draws are from those that no other controller claims. Left out, none, or its previous ones if it joins again. */
  select?: Select | null;
}

/** Removes a controller. Its individuals become uninformed, unless it joined with `hold`. */
export interface LeaveArgs {
  /** The controller's name. */
  controller: string;
}

/** When a swarm with a controller steps. */
export type Mode = "lockstep" | "free_running";

/** What happens to the individuals of a late controller. */
export type OnTimeout = "hold" | "free" | "pause";

/** A recording to show, and its name. */
export interface OpenArgs {
  /** The name of the playback. */
  name: string;
  /** A recording of the daemon; left out, the one uploaded under this name. */
  recording?: string | null;
}

/** Pauses a swarm; no change if it is paused. */
export type PauseArgs = Record<string, never>;

/** Where a body is, in absolute positions. */
export interface Pose {
  /** Its heading in radians, counter-clockwise from +x. */
  alpha: number;
  /** Its centre, body sizes. */
  x: number;
  /** Its centre, body sizes. */
  y: number;
}

/** Protects a swarm from `delete` and `reset`, which it then rejects with `incorrect_state`, or ends that. In every phase. It changes neither the state nor the random draws of later commands. */
export interface ProtectArgs {
  /** Whether the swarm is protected from now on. */
  on: boolean;
}

/** A command to a recording; sent to a node. */
export type RecordArgs = {
  begin: BeginRecordingArgs;
} | {
  stop: RecordingName;
} | {
  delete: RecordingName;
};

/** Which recording. */
export interface RecordingName {
  /** Its name. */
  recording: string;
}

/** A disc, in absolute positions and body sizes. */
export interface Region {
  /** Its radius, above 0. */
  radius: number;
  /** Its centre. */
  x: number;
  /** Its centre. */
  y: number;
}

/** Takes individuals out of the group. The last one cannot be removed. */
export interface RemoveArgs {
  /** The individuals; draws are from all. */
  select: Select;
}

/** A command to a playback; sent to a node. */
export type ReplayArgs = {
  upload: UploadArgs;
} | {
  open: OpenArgs;
};

/** A request; every field is optional. */
export interface CommandRequest {
  /** The verb's arguments. */
  args?: Record<string, unknown> | null;
  /** Execute it when the swarm is at this step. One in the past is a `conflict`; one in the future is acknowledged at once with `applies_at_step`, and an event has its result. */
  at_step?: number | null;
  /** The client, as the request names it. */
  client?: string | null;
  /** Reject with `conflict` unless the swarm is in this epoch. */
  expect_epoch?: number | null;
  /** Reject with `conflict` unless the swarm is at this step. */
  expect_step?: number | null;
  /** The client's id for this request. A request is executed once for each `client` and `request_id`; a retry gets the first reply. */
  request_id?: string | null;
  /** After this many seconds the reply is `deadline_exceeded`; the daemon continues with it. Above 0, at most 3600; 5 if left out. */
  timeout_secs?: number | null;
}

/** Restarts a swarm from its spec, at step 0 of a new epoch, paused. */
export interface ResetArgs {
  /** A new seed: 0 to 2⁵³ - 1; left out, the old one. */
  seed?: number | null;
}

/** Creates a swarm from a snapshot, paused; sent to a node. */
export interface RestoreArgs {
  /** The new swarm's name. */
  name: string;
  /** The snapshot as `get/snapshot` gave it, its CBOR as base64. */
  snapshot: string;
}

/** What the reply to `step` contains. */
export type Return = "none" | "state";

/** Runs a swarm to an end or until it is paused; changes the end and the rate of a running one. Fields that are left out keep their values. */
export interface RunArgs {
  /** Time units per second of wall clock; `null` is as fast as possible; left out, no change. */
  rate?: number | null;
  /** Pause when this step is reached. At most one of `until_step` and `until_time`. */
  until_step?: number | null;
  /** Pause at the first step at or after this time. */
  until_time?: number | null;
}

/** Moves a playback to the last frame that is not later. Exactly one field must be given. */
export interface SeekArgs {
  /** A share of the whole recording: 0 to 1. */
  fraction?: number | null;
  /** A step; if the swarm was reset, of the epoch that is shown. */
  step?: number | null;
  /** A time; if the swarm was reset, of the epoch that is shown. */
  time?: number | null;
}

/** The individuals that a command changes. A draw is seeded by the swarm's seed and `seq` minus the number of annotations so far. */
export type Select = {
  ids: number[];
} | {
  count: number;
} | {
  fraction: number;
} | {
  within: Region;
} | {
  informed: boolean;
} | {
  foremost: Foremost;
};

/** Changes the given parameters, at least one. A new `pi2` is not that of individuals informed before; `contacts` other than `closest` require that no axes cross. */
export interface SetArgs {
  /** The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes faster from some thousand individuals on; others are `voronoi`, `metric` with a `radius` in body sizes, `topological` with a number of `neighbours`, and `power` with an `exponent`. */
  attraction?: Attraction | null;
  /** Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one with the smallest gap; or, for comparison, `clamped`, which adds redundant ones. */
  contacts?: ContactRule | null;
  /** With `pi1`: scale all positions about the centroid by the smallest factor that lets longer bodies fit. */
  make_room?: boolean;
  /** Remove a controller in lock-step for which the swarm has waited so many seconds, and which has sent nothing meanwhile: 0.1 to 10⁶; 0 is no limit, as in a new swarm. */
  max_idle_secs?: number | null;
  /** The measures in each published order, such as `milling`, at most 16 that need no earlier state; none if empty. */
  measures?: string[] | null;
  /** Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶. */
  noise?: number | null;
  /** Length over width of a body: 1 (a disc) to 32. */
  pi1?: number | null;
  /** Weight of individuals that are informed without a weight: 0 to 10⁶. */
  pi2?: number | null;
  /** Body size over turning radius: above 0, to 10⁶. */
  pi3?: number | null;
  /** Translational over rotational drag: above 0, to 10⁶. */
  pi4?: number | null;
  /** Number of steps between two published states: 1 or more. */
  publish_every?: number | null;
  /** Number of further programs that a step solves about the result of the last one: 0, or 1, which leaves less overlap and requires `position`. */
  relinearise?: number | null;
  /** What a contact limits: `position`, the gap after the step, or `velocity`, the speed at which touching bodies approach each other. */
  stepping?: Stepping | null;
}

/** Set-points of individuals that a controller steers: columns of equal length. */
export interface SetPoints {
  /** Their preferred directions in radians, counter-clockwise from +x. */
  direction: number[];
  /** The individuals. */
  ids: number[];
  /** Beyond the paper, for controllers that joined with `driving`: factors of the free speed, 0 to 1. `null` for the model's. */
  speed?: (number | null)[] | null;
  /** Beyond the paper, for controllers that joined with `driving`: turning rates, angle over time, instead of those of the model; limited to the fastest free one, `pi3 (1 + largest weight)`. `null` for the model's. */
  turn?: (number | null)[] | null;
  /** How much each counts beside attraction, 0 for uninformed; `pi2` each if left out. */
  weight?: number[] | null;
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

/** Takes steps of a paused swarm as fast as possible, independent of its rate. */
export interface StepArgs {
  /** What the reply contains. */
  return?: Return;
  /** How many steps: 1 to 10⁹. */
  steps?: number;
}

/** What a contact limits. */
export type Stepping = "position" | "velocity";

/** An experiment to execute. */
export interface SubmitArgs {
  /** Execute all runs again, beside the experiment of this name, if another version of the model executed that one's runs: `school` becomes `school-model2` under version 2. */
  again?: boolean;
  /** Its name; that in the file if left out. */
  name?: string | null;
  /** The contents of the CSV that `points` in the file names. */
  points?: string | null;
  /** The contents of the CSV that `setpoints` in the file names. */
  setpoints?: string | null;
  /** The contents of the snapshot that `start` in the file names, its CBOR as base64. */
  start?: string | null;
  /** The file that describes it, TOML. */
  toml: string;
}

/** Takes the preferred direction of individuals away. */
export interface UninformArgs {
  /** The individuals; draws are from the informed. */
  select: Select;
}

/** A piece of a recording. */
export interface UploadArgs {
  /** The piece, as base64. */
  bytes: string;
  /** How long the whole file is, in bytes. */
  length: number;
  /** The name of the playback. */
  name: string;
  /** Where in the file the piece begins, in bytes; 0 begins a new upload. */
  offset: number;
}

/** Pauses a swarm, applies changes or publishes an event, once, at the first step after which a condition holds. `condition`, or `cancel` alone or with `event` or `id`; with a condition exactly one of `pause`, `commands` and `event`. */
export interface WhenArgs {
  /** Remove the condition at this step, without evaluating it there. */
  before_step?: number | null;
  /** Remove all waiting conditions, or with `event` the one with this name, or with `id` the one of this id. */
  cancel?: boolean;
  /** Apply these changes as a `batch`: all at one step, or none. */
  commands?: Change[] | null;
  /** The condition, such as `order > 0.9 for 20`: 1 to 1000 characters. A waiting condition with the same text and action is replaced. */
  condition?: string | null;
  /** With `commands`: as `draw` of `batch`. */
  draw?: number | null;
  /** Only publish the event `fired` with this name, which has the form of a swarm's name; `get/wait` waits for it. A waiting condition with the same name is replaced. Such a command counts as an annotation: it changes no random draw. */
  event?: string | null;
  /** Evaluate states from this step on. If the swarm is there already, its present state is the first: if the condition holds in it, nothing waits. Left out, the first is that after the next step. */
  from_step?: number | null;
  /** With `cancel`: the id of a condition, which `get/status` has. */
  id?: string | null;
  /** Pause the swarm. */
  pause?: boolean;
  /** The command is part of a protocol. With `commands`: as `protocol` of `batch`. With `pause`: the condition ends the protocol: the commands of this step are not executed, and the scheduled commands and the other conditions, except those with `event`, are removed. */
  protocol?: boolean;
}

/** The commands that a controller may send. */
export const OF_CONTROLLERS = ["join", "advance", "leave", "annotate"];
