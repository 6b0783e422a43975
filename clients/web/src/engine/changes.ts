/** The changes of a swarm between two snapshots, from its events, as an engine applies them. */
import type { SwarmEvent } from "../wire/page.ts";
import type { Snapshot } from "../wire/snapshot.ts";

export interface Change {
  verb: string;
  args: unknown;
}

/** A change, the step before which it is applied, and the number on which its random draws depend. */
export interface Applied {
  step: number;
  seq: number;
  change: Change;
}

/** The verbs of one change. */
const CHANGES = ["set", "inform", "uninform", "inject", "remove"];
/** The verbs of several changes, which are their `commands`. */
const SEVERAL = ["batch", "fired"];
/** The verbs that count, but on whose number no draw depends. */
const NOTES = ["annotate", "protect"];

/** Why the set-points of a controller cannot be executed again. */
export function lacksSetPoints(why: string): string {
  return `${why}, and events do not contain its set-points: jostle verify replays them from the journal`;
}

/** The changes between two snapshots of one epoch; throws if the events do not tell them all. */
export function changesBetween(
  from: Pick<Snapshot, "seq" | "annotations">,
  to: Pick<Snapshot, "seq">,
  events: readonly SwarmEvent[],
): Applied[] {
  const found: Applied[] = [];
  let { annotations, seq } = from;
  for (const { step, event } of events) {
    const number = Number(event.seq);
    if (event.kind !== "command" || !(number > from.seq && number <= to.seq)) {
      continue;
    }
    const verb = String(event.verb);
    if (verb === "join") {
      throw new Error(lacksSetPoints("a controller has joined"));
    }
    const args = (event.args ?? {}) as { commands?: Change[] | null; protocol?: boolean };
    if (args.protocol) {
      throw new Error("an experiment plays on this swarm: its draws have other numbers");
    }
    let changes: Change[] = [];
    if (CHANGES.includes(verb)) {
      changes = [{ verb, args }];
    } else if (SEVERAL.includes(verb)) {
      changes = args.commands ?? [];
    }
    seq += Math.max(1, changes.length);
    if (seq !== number) {
      throw new Error(`the daemon no longer has the event of command ${seq}`);
    }
    if (NOTES.includes(verb)) {
      annotations += 1;
    }
    changes.forEach((change, k) => {
      found.push({ step, seq: seq - annotations - changes.length + 1 + k, change });
    });
  }
  if (seq !== to.seq) {
    throw new Error(`the daemon no longer has the events of commands ${seq + 1} to ${to.seq}`);
  }
  return found;
}
