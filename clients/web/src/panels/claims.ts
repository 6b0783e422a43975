/** What a browser can compute again of a swarm, and what the daemon says the result is. */
import { changesBetween, lacksSetPoints } from "../engine/changes.ts";
import type { Task } from "../engine/job.ts";
import { currentSnapshot, get, RequestError } from "../wire/http.ts";
import type { ControllerList, ExperimentFile, Status } from "../wire/messages.ts";
import type { EventsPage, SwarmEvent } from "../wire/page.ts";
import type { Snapshot } from "../wire/snapshot.ts";

export interface Claim {
  task: Task;
  /** The step of the snapshot that it begins with; null if it begins with the swarm's start. */
  from: number | null;
  steps: number;
  state_hash: string;
}

/** Codes of the errors after which a swarm has no file of its commands: they do not begin at its start,
 * or are too many. */
const NO_FILE = ["conflict", "resource_exhausted"];
/** The least time between two snapshots. */
const SPAN_MS = 3000;
/** The longest time in which a swarm must take a step. */
const WAIT_MS = 10_000;
const NO_STEPS = "the swarm takes no steps: run it, and verify it while it runs";
const POLL_MS = 500;
const MAX_EVENTS = 1000;

/** Requests a claim: from the start if the daemon has all commands since, else from now on; `waits` is
 * called with the reason why it takes some seconds. */
export async function requestClaim(swarm: string, waits: (reason: string) => void): Promise<Claim> {
  try {
    const { result } = await get<ExperimentFile>(swarm, "experiment");
    const { file: toml, steps, state_hash } = result;
    const files = { toml };
    return { task: { kind: "run", files, run: 0, spacing: null }, from: null, steps, state_hash };
  } catch (error) {
    if (!(error instanceof RequestError && NO_FILE.includes(error.code))) {
      throw error;
    }
    waits(error.message);
    return claimFromNow(swarm);
  }
}

async function claimFromNow(swarm: string): Promise<Claim> {
  const { phase } = await get<Status>(swarm, "status");
  if (phase === "faulted") {
    throw new Error("the swarm takes no steps: it is faulted. jostle verify replays its journal");
  }
  if (phase === "paused") {
    throw new Error(NO_STEPS);
  }
  const from = await currentSnapshot(swarm);
  const { controllers } = (await get<ControllerList>(swarm, "controllers")).result;
  if (controllers[0]) {
    throw new Error(
      lacksSetPoints(`the controller ${controllers[0].controller} steers individuals`),
    );
  }
  const to = await laterSnapshot(swarm, from);
  const changes = changesBetween(from, to, await allEvents(swarm));
  const task: Task = { kind: "replay", snapshot: base64(from.bytes), changes, until: to.step };
  return { task, from: from.step, steps: to.step, state_hash: to.state_hash };
}

/** The snapshot at a later step. */
async function laterSnapshot(swarm: string, from: Snapshot): Promise<Snapshot> {
  const began = performance.now();
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
    const passed = performance.now() - began;
    const to = await currentSnapshot(swarm);
    if (to.epoch !== from.epoch) {
      throw new Error("the swarm was reset or restored meanwhile");
    }
    if (to.step > from.step && passed >= SPAN_MS) {
      return to;
    }
    if (passed >= WAIT_MS) {
      throw new Error(NO_STEPS);
    }
  }
}

/** The events that the daemon has. */
async function allEvents(swarm: string): Promise<SwarmEvent[]> {
  const all: SwarmEvent[] = [];
  for (let at = 0, newest = 1; at < newest; ) {
    const page = await get<EventsPage>(swarm, `events?after=${at}&limit=${MAX_EVENTS}`);
    all.push(...page.result.events);
    newest = page.result.newest;
    at = page.result.events.at(-1)?.number ?? newest;
  }
  return all;
}

function base64(bytes: Uint8Array): string {
  return btoa(Array.from(bytes, (it) => String.fromCharCode(it)).join(""));
}
