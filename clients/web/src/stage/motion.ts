/**
 * What is shown between two states: a state is reached in the time that the last took to come, so
 * that ten states a second still move smoothly. Nothing is guessed ahead, and what stands is exact.
 *
 * Between states that are further apart in the swarm's time than a given limit the positions are not
 * interpolated: bodies would be drawn on straight lines that they never took, across one another.
 */
import type { Bodies } from "../geometry/touching.ts";
import { type State, shift } from "../wire/state.ts";

/** Longer pauses than this are jumps. */
const LONGEST_MS = 250;

interface Start extends Bodies {
  /** The swarm's time that these positions are of. */
  time: number;
}

export class Motion {
  newest: State | null = null;
  private from: Start | null = null;
  private shown: Bodies | null = null;
  private began = 0;
  private lasts = 0;
  private came = 0;
  private interval = 100;

  /**
   * Takes a newer state; returns how positions shift, since its origin may be another. States that
   * are `limit` time units or more apart are shown without motion between them.
   */
  accept(state: State, now: number, at_once: boolean, limit: number): [number, number] {
    const before = this.newest;
    const by = before ? shift(before.origin, state.origin) : ([0, 0] as [number, number]);
    const waited = now - this.came;
    this.came = now;
    const shown = before ? this.present(now, before) : null;
    this.newest = state;
    this.from = null;
    if (!before || !shown || at_once || !continues(before, state) || waited > LONGEST_MS) {
      return by;
    }
    // What is shown may be older than the state before this one.
    const start = [shown, before].find((it) => state.time - it.time < limit);
    if (!start) {
      return by;
    }
    this.interval += 0.2 * (waited - this.interval);
    this.from = {
      time: start.time,
      x: start.x.map((x) => x + by[0]),
      y: start.y.map((y) => y + by[1]),
      alpha: start.alpha.slice(),
    };
    this.began = now;
    this.lasts = Math.min(LONGEST_MS, Math.max(8, this.interval));
    return by;
  }

  /** Whether there is more to show than was shown. */
  isMoving(): boolean {
    return this.from !== null;
  }

  /** The bodies as they are to be shown. */
  at(now: number): Bodies {
    const to = this.newest!;
    const part = this.part(now);
    if (!this.from || part >= 1) {
      this.from = null;
      return to;
    }
    const n = to.x.length;
    if (this.shown?.x.length !== n) {
      this.shown = { x: new Float64Array(n), y: new Float64Array(n), alpha: new Float64Array(n) };
    }
    const { shown, from } = this;
    for (let i = 0; i < n; i += 1) {
      shown.x[i] = from.x[i]! + part * (to.x[i]! - from.x[i]!);
      shown.y[i] = from.y[i]! + part * (to.y[i]! - from.y[i]!);
      shown.alpha[i] = from.alpha[i]! + part * (to.alpha[i]! - from.alpha[i]!);
    }
    return shown;
  }

  clear(): void {
    this.newest = null;
    this.from = null;
  }

  /** The fraction of the interpolation to the newest state that has elapsed. */
  private part(now: number): number {
    return this.from ? Math.max(0, (now - this.began) / this.lasts) : 1;
  }

  /** What is shown now, and the swarm's time that it is of. */
  private present(now: number, newest: State): Start {
    const { from } = this;
    const part = Math.min(1, this.part(now));
    const time = from ? from.time + part * (newest.time - from.time) : newest.time;
    const { x, y, alpha } = this.at(now);
    return { time, x, y, alpha };
  }
}

/** Whether the second state is the first's future, of the same individuals. */
export function continues(before: State, after: State): boolean {
  return (
    after.epoch === before.epoch &&
    after.step >= before.step &&
    after.id.length === before.id.length &&
    after.id.every((id, i) => id === before.id[i])
  );
}
