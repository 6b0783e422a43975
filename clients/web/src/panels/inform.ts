/** Sends `inform`, and offers to undo exactly that command. */
import { announce, attempt, checkMayCommand } from "../ui/announce.ts";
import { degrees, fixed, plural } from "../ui/format.ts";
import type { Session } from "../ui/session.ts";
import { command, currentState } from "../wire/http.ts";
import type { Reply } from "../wire/messages.ts";

interface Chosen {
  ids: number[];
  n: number;
}

export interface Preference {
  /** Radians, counter-clockwise from +x. */
  direction: number;
  /** The parameter pi2 if left out. */
  weight?: number;
}

/** The cosine of the angle between directions that are the same but for rounding. */
const SAME = 1 - 1e-12;

/** Informs individuals. The message offers to uninform those that were not informed before. */
export async function inform(
  swarm: string,
  session: Session,
  ids: number[],
  preference: Preference,
): Promise<void> {
  if (ids.length === 0) {
    announce("no individual is selected");
    return;
  }
  if (!checkMayCommand(session)) {
    return;
  }
  await attempt(async () => {
    const before = await currentState(swarm);
    const had = new Set(before.id.filter((_, i) => before.weight[i]! > 0));
    const args = { select: { ids }, ...preference };
    const reply = await command<Chosen>(swarm, "inform", args);
    const fresh = reply.result.ids.filter((id) => !had.has(id));
    const informed = plural(reply.result.ids.length, "individual");
    const direction = fixed(degrees(preference.direction), 0);
    const replaced = reply.result.ids.length - fresh.length;
    announce(`${informed} informed: ${direction}°${changed(replaced)}`, {
      label: replaced > 0 ? `Undo for ${fresh.length}` : "Undo",
      act: fresh.length > 0 ? () => undo(swarm, reply, fresh, preference) : undefined,
    });
  });
}

/** Replaced directions cannot be restored: a state does not contain when they lapse. */
function changed(count: number): string {
  return count === 0 ? "" : `, ${count} of them replacing another direction`;
}

/**
 * Uninforms individuals that still have the direction. After a reset, or in another swarm of the name, the ids
 * are those of other individuals.
 */
async function undo(
  swarm: string,
  { epoch }: Reply<Chosen>,
  ids: number[],
  { direction }: Preference,
): Promise<void> {
  await attempt(async () => {
    const now = await currentState(swarm);
    const has = (i: number) => now.weight[i]! > 0 && Math.cos(now.direction[i]! - direction) > SAME;
    const those = new Set(now.id.filter((_, i) => has(i)));
    const left = ids.filter((id) => those.has(id));
    if (now.epoch !== epoch || left.length === 0) {
      announce("none of these individuals has that direction any longer");
      return;
    }
    await command(swarm, "uninform", { select: { ids: left } }, { expect_epoch: epoch });
    announce(`undone: ${plural(left.length, "individual")} uninformed`);
  });
}
