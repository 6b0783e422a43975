/**
 * What is shown between two states: a state is reached in the time that the last took to come, so
 * that ten states a second still move smoothly. Nothing is guessed ahead, and what stands is exact.
 */
import type { Bodies } from "../geometry/touching.ts";
import { type State, shift } from "../wire/state.ts";

/** Longer pauses than this are jumps. */
const LONGEST_MS = 250;

export class Motion {
  newest: State | null = null;
  private from: Bodies | null = null;
  private shown: Bodies | null = null;
  private began = 0;
  private lasts = 0;
  private came = 0;
  private interval = 100;

  /** Takes a newer state; returns how positions shift, since its origin may be another. */
  accept(state: State, now: number, at_once: boolean): [number, number] {
    const before = this.newest;
    const by = before ? shift(before.origin, state.origin) : ([0, 0] as [number, number]);
    const waited = now - this.came;
    this.came = now;
    const shown = before ? this.at(now) : null;
    this.newest = state;
    this.from = null;
    if (!before || !shown || at_once || !continues(before, state) || waited > LONGEST_MS) {
      return by;
    }
    this.interval += 0.2 * (waited - this.interval);
    this.from = {
      x: shown.x.map((x) => x + by[0]),
      y: shown.y.map((y) => y + by[1]),
      alpha: shown.alpha.slice(),
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
    const part = this.from ? (now - this.began) / this.lasts : 1;
    if (!this.from || part >= 1) {
      this.from = null;
      return to;
    }
    const n = to.x.length;
    if (this.shown?.x.length !== n) {
      this.shown = { x: new Float64Array(n), y: new Float64Array(n), alpha: new Float64Array(n) };
    }
    const { shown, from } = this;
    const fraction = Math.max(0, part);
    for (let i = 0; i < n; i += 1) {
      shown.x[i] = from.x[i]! + fraction * (to.x[i]! - from.x[i]!);
      shown.y[i] = from.y[i]! + fraction * (to.y[i]! - from.y[i]!);
      shown.alpha[i] = from.alpha[i]! + fraction * (to.alpha[i]! - from.alpha[i]!);
    }
    return shown;
  }

  clear(): void {
    this.newest = null;
    this.from = null;
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
