/**
 * Interpolates positions between two states over the mean interval at which states arrive, so that
 * ten states a second move smoothly. Nothing is extrapolated, and a paused swarm is drawn exactly.
 *
 * States further apart in simulated time than a given limit are not interpolated: straight lines
 * would move bodies through one another.
 */
import type { Bodies } from "../geometry/touching.ts";
import { type Drawn, shift } from "../wire/state.ts";

/** After a longer pause the next state is shown without interpolation. */
const MAX_MOTION_MS = 250;

interface Start extends Bodies {
  /** The simulated time of these positions. */
  time: number;
}

export class Motion<State extends Drawn = Drawn> {
  newest: State | null = null;
  private from: Start | null = null;
  private shown: Bodies | null = null;
  private began = 0;
  private lasts = 0;
  private came = 0;
  private interval = 100;

  /**
   * Accepts a newer state; returns the shift of positions if the origin changed. States `limit` time
   * units or more apart are not interpolated.
   */
  accept(state: State, now: number, at_once: boolean, limit: number): [number, number] {
    const before = this.newest;
    const by = before ? shift(before.origin, state.origin) : ([0, 0] as [number, number]);
    const waited = now - this.came;
    this.came = now;
    const shown = before ? this.present(now, before) : null;
    this.newest = state;
    this.from = null;
    if (!before || !shown || at_once || !continues(before, state) || waited > MAX_MOTION_MS) {
      return by;
    }
    // The positions on the screen may be older than the previous state.
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
    this.lasts = Math.min(MAX_MOTION_MS, Math.max(8, this.interval));
    return by;
  }

  /** Whether an interpolation is in progress. */
  isMoving(): boolean {
    return this.from !== null;
  }

  /** The bodies to draw. */
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

  /** The fraction of the interpolation to the newest state that has elapsed. */
  private part(now: number): number {
    return this.from ? Math.max(0, (now - this.began) / this.lasts) : 1;
  }

  /** The positions on the screen and their simulated time. */
  private present(now: number, newest: Drawn): Start {
    const { from } = this;
    const part = Math.min(1, this.part(now));
    const time = from ? from.time + part * (newest.time - from.time) : newest.time;
    const { x, y, alpha } = this.at(now);
    return { time, x, y, alpha };
  }
}

/** Whether the second state continues the first, with the same individuals. */
export function continues(before: Drawn, after: Drawn): boolean {
  return (
    after.epoch === before.epoch &&
    after.step >= before.step &&
    after.id.length === before.id.length &&
    after.id.every((id, i) => id === before.id[i])
  );
}
