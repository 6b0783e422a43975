/**
 * What a worker does with an engine: it executes a run of an experiment, or the changes of a swarm since
 * a snapshot, in slices, and reports its progress, frames to draw, and its end.
 */
import type { Columns } from "../wire/state.ts";
import type { Applied } from "./changes.ts";
import { type Engine, EngineError, type FullSpec, type PlanFiles, type Status } from "./engine.ts";

/** A job, and the module that executes it, uncompressed. */
export type Job = Task & { module: ArrayBuffer };
export type Task = RunTask | ReplayTask;

export interface RunTask {
  kind: "run";
  files: PlanFiles;
  /** The index of the run. */
  run: number;
  /** Its name, if that is known: a run of another name is an error. */
  name?: string | undefined;
  /** The least time between two frames, time units; null if no frames are wanted. */
  spacing: number | null;
}

export interface ReplayTask {
  kind: "replay";
  /** The snapshot, in base64. */
  snapshot: string;
  /** In the order in which they are applied. */
  changes: Applied[];
  /** The last step. */
  until: number;
}

/** A state of the run. */
export interface Frame
  extends Columns,
    Pick<Status, "step" | "pi1" | "order" | "drift" | "contacts"> {}

export type Report =
  /** It has begun at a step, and takes as many steps, at most; null in place of the spec in a replay. */
  | { kind: "begun"; step: number; steps: number; spec: FullSpec | null }
  | { kind: "progress"; step: number; frames: Frame[] }
  | { kind: "finished"; step: number; state_hash: string; fault: string | null }
  | { kind: "failed"; code: string; message: string; details: Record<string, unknown> };

/** The wall time of a slice, after which a worker reports. */
const SLICE_MS = 50;
/** The most memory of the frames of a run. */
const MAX_FRAMES_BYTES = 64e6;
/** Of an individual in a frame: five doubles and an id. */
const POSE_BYTES = 44;

/** The steps between two frames, so that those of the run fit in the memory. */
export function spacingOf(least: number, steps: number, n: number): number {
  const most = Math.max(1, Math.floor(MAX_FRAMES_BYTES / (POSE_BYTES * Math.max(1, n))));
  return Math.max(least, Math.ceil(steps / most));
}

/** Executes a task. `now` is a clock in milliseconds. */
export function execute(
  engine: Pick<Engine, "request" | "columns">,
  task: Task,
  report: (report: Report) => void,
  now: () => number,
): void {
  try {
    if (task.kind === "run") {
      run(engine, task, report, now);
    } else {
      replay(engine, task, report, now);
    }
  } catch (error) {
    report(failure(error));
  }
}

export function failure(error: unknown): Report {
  const { code, details } =
    error instanceof EngineError ? error : { code: "internal", details: {} };
  const message = error instanceof Error ? error.message : String(error);
  return { kind: "failed", code, message, details };
}

function run(
  engine: Pick<Engine, "request" | "columns">,
  task: RunTask,
  report: (report: Report) => void,
  now: () => number,
): void {
  const planned = engine.request("plan", task.files).runs[task.run];
  if (!planned || planned.name !== (task.name ?? planned.name)) {
    const name = task.name === undefined ? "" : ` "${task.name}"`;
    const message = `the experiment has no run${name} with the number ${task.run + 1}`;
    throw new EngineError("not_found", message);
  }
  const { spec } = engine.request("spec", { run: task.run });
  let status: Status = engine.request("run", { run: task.run });
  report({ kind: "begun", step: 0, steps: planned.steps, spec });
  const least = task.spacing === null ? 0 : Math.max(1, Math.round(task.spacing / spec.dt));
  const spacing = least && spacingOf(least, planned.steps, planned.n);
  let frames: Frame[] = [];
  const keep = () => {
    const { step, pi1, order, drift, contacts } = status;
    frames.push({ step, pi1, order, drift, contacts, ...engine.columns() });
  };
  if (spacing > 0) {
    keep();
  }
  const pace = new Pace(now);
  for (let finished = false; !finished; ) {
    const steps = spacing || pace.steps;
    const reply = pace.time(() => engine.request("advance", { steps }));
    ({ finished } = reply);
    const isNew = reply.step > status.step;
    status = reply;
    if (spacing > 0 && isNew) {
      keep();
    }
    if (finished || pace.isDue()) {
      report({ kind: "progress", step: status.step, frames });
      frames = [];
    }
  }
  const { step, state_hash, fault } = status;
  report({ kind: "finished", step, state_hash, fault });
}

function replay(
  engine: Pick<Engine, "request">,
  { snapshot, changes, until }: ReplayTask,
  report: (report: Report) => void,
  now: () => number,
): void {
  let status = engine.request("restore", { snapshot });
  report({ kind: "begun", step: status.step, steps: until - status.step, spec: null });
  const pace = new Pace(now);
  const stepTo = (step: number) => {
    while (status.step < step && status.fault === null) {
      const steps = Math.min(pace.steps, step - status.step);
      status = pace.time(() => engine.request("step", { steps }));
      if (pace.isDue()) {
        report({ kind: "progress", step: status.step, frames: [] });
      }
    }
  };
  for (const { step, seq, change } of changes) {
    stepTo(step);
    engine.request("apply", { change, seq });
  }
  stepTo(until);
  // A change at the last step is a part of its state, too.
  const { step, state_hash, fault } = engine.request("status", {});
  report({ kind: "finished", step, state_hash, fault });
}

/** The number of steps of a slice. */
class Pace {
  steps = 1;
  private reported: number;

  constructor(private readonly now: () => number) {
    this.reported = now();
  }

  /** Takes a slice of `steps` steps; the next one has as many as take the time of a slice. */
  time<T>(slice: () => T): T {
    const began = this.now();
    const result = slice();
    const passed = this.now() - began;
    if (passed < SLICE_MS / 2) {
      this.steps *= 2;
    } else if (passed > 2 * SLICE_MS) {
      this.steps = Math.max(1, Math.floor(this.steps / 2));
    }
    return result;
  }

  /** Whether the time of a slice has passed since this was last true. */
  isDue(): boolean {
    const now = this.now();
    if (now - this.reported < SLICE_MS) {
      return false;
    }
    this.reported = now;
    return true;
  }
}
