/**
 * The engine: the WebAssembly module of `crates/wasm`, which steps a swarm as the daemon does. An
 * instance is one swarm, or one run of an experiment.
 *
 * A request and its reply are JSON in the memory of the module, where the columns of the present swarm
 * are, too. A call may grow the memory, which detaches views on it: they are made again after each call.
 */
import type { Order } from "../wire/messages.ts";
import type { Spec } from "../wire/requests.ts";
import type { Columns } from "../wire/state.ts";

/** What the module exports; it imports nothing. */
interface Exports {
  memory: WebAssembly.Memory;
  input(length: number): number;
  request(): void;
  output(): number;
  output_len(): number;
  column(which: number): number;
  ids(): number;
  n(): number;
}

/** The swarm, or the run, after a request. */
export interface Status {
  step: number;
  time: number;
  n: number;
  pi1: number;
  state_hash: string;
  order: Order["order"];
  drift: number | null;
  residual: number;
  iterations: number;
  contacts: number;
  degraded: boolean;
  mean_order: number | null;
  /** Why the last step failed; null if it did not. */
  fault: string | null;
}

export interface Version {
  version: string;
  model_version: number;
  /** Such as "wasm32 simd128". */
  target: string;
}

/** An experiment file, with the files that it names: those of points and set-points as text, a
 * starting snapshot as base64. */
export interface PlanFiles {
  toml: string;
  points?: string;
  start?: string;
  setpoints?: string;
}

export interface PlannedRun {
  name: string;
  steps: number;
  n: number;
}

export interface Plan {
  name: string;
  runs: PlannedRun[];
}

/** A slice of a run. */
export interface Advance extends Status {
  finished: boolean;
  /** The row of the result, and its table as CSV; null before the end. */
  row: Record<string, unknown> | null;
  csv: string | null;
}

/** A spec with its defaults. */
export type FullSpec = Required<Spec>;

/** The requests, with their arguments and replies. */
export interface Requests {
  version: [Record<string, never>, Version];
  create: [{ spec: Spec }, Status];
  restore: [{ snapshot: string }, Status];
  snapshot: [Record<string, never>, { snapshot: string }];
  apply: [{ change: { verb: string; args: unknown }; seq?: number }, { n: number }];
  step: [{ steps: number }, Status];
  status: [Record<string, never>, Status];
  measures: [{ measures: string[] }, { values: (number | null)[] }];
  plan: [PlanFiles, Plan];
  spec: [{ run: number }, { spec: FullSpec }];
  run: [{ run: number }, Status];
  advance: [{ steps: number }, Advance];
}

/** A request that the engine rejected; `code` is `panic` if the engine failed and is discarded. */
export class EngineError extends Error {
  readonly code: string;
  readonly details: Record<string, unknown>;

  constructor(code: string, message: string, details: Record<string, unknown> = {}) {
    super(message);
    this.code = code;
    this.details = details;
  }
}

type Reply = {
  ok?: unknown;
  error?: { code: string; message: string; details?: Record<string, unknown> | null };
};

const DISCARDED = "the engine was discarded after an error";

export class Engine {
  private constructor(private exports: Exports | null) {}

  /** An instance of the module with these bytes. */
  static async of(module: BufferSource): Promise<Engine> {
    const { instance } = await WebAssembly.instantiate(module);
    return new Engine(instance.exports as unknown as Exports);
  }

  /** Executes a request; throws an EngineError if the engine rejects it. */
  request<Name extends keyof Requests>(name: Name, args: Requests[Name][0]): Requests[Name][1] {
    const { exports } = this;
    if (!exports) {
      throw new EngineError("panic", DISCARDED);
    }
    const bytes = new TextEncoder().encode(JSON.stringify({ [name]: args }));
    try {
      const at = exports.input(bytes.length);
      new Uint8Array(exports.memory.buffer, at, bytes.length).set(bytes);
      exports.request();
    } catch (error) {
      this.exports = null;
      throw new EngineError("panic", textOfPanic(exports) || String(error));
    }
    const reply = JSON.parse(text(exports)) as Reply;
    if (reply.error) {
      const { code, message, details } = reply.error;
      throw new EngineError(code, message, details ?? {});
    }
    return reply.ok as Requests[Name][1];
  }

  /** The columns of the present swarm. */
  columns(): Columns {
    const { exports } = this;
    if (!exports) {
      throw new EngineError("panic", DISCARDED);
    }
    const n = exports.n();
    // Each call invalidates the views before it: copies remain.
    const column = (which: number) => {
      const at = exports.column(which);
      return new Float64Array(exports.memory.buffer, at, n).slice();
    };
    const [x, y, alpha, weight, direction] = [
      column(0),
      column(1),
      column(2),
      column(3),
      column(4),
    ];
    const ids = exports.ids();
    const id = new Uint32Array(exports.memory.buffer, ids, n).slice();
    return { id, x, y, alpha, weight, direction };
  }
}

/** The output of the module. */
function text(exports: Exports): string {
  const at = exports.output();
  return new TextDecoder().decode(new Uint8Array(exports.memory.buffer, at, exports.output_len()));
}

/** The text of a panic; empty if the module cannot tell it. */
function textOfPanic(exports: Exports): string {
  try {
    return text(exports);
  } catch {
    return "";
  }
}
