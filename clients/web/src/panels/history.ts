/** The data of the charts: the newest numbers of a swarm over its simulated time. */
import type { OrderSample } from "../wire/messages.ts";
import type { State } from "../wire/state.ts";

export const MAX_POINTS = 2000;
/** Wall time between two points: the daemon sends up to fifty states a second. */
const SPACING_MS = 100;

export const SERIES = ["order", "drift", "contacts", "real_time_factor"] as const;
export type Series = (typeof SERIES)[number];

/** The numbers of a swarm at one step; the panel and the charts show the same moment. */
export interface Moment extends Record<Series, number | null> {
  epoch: number;
  step: number;
  time: number;
  n: number;
  informed: number;
  direction: number | null;
  direction_strength: number | null;
}

export function momentOfState(state: State, real_time_factor: number | null): Moment {
  const informed = state.weight.reduce((sum, it) => sum + (it > 0 ? 1 : 0), 0);
  return momentOfOrder({ ...state, n: state.id.length, informed, real_time_factor });
}

export function momentOfOrder(it: Omit<OrderSample, "frame" | "rate" | "phase">): Moment {
  const { epoch, step, time, n, informed, real_time_factor } = it;
  const { order, direction, direction_strength = null, drift } = it.order;
  const { contacts } = it.certificate;
  const numbers = { order, drift, contacts, real_time_factor };
  return { epoch, step, time, n, informed, direction, direction_strength, ...numbers };
}

/** The indices of values without a neighbour. */
export function isolated(column: ArrayLike<number | null | undefined>): number[] {
  const is = (k: number) => typeof column[k] === "number";
  return Array.from({ length: column.length }, (_, k) => k).filter(
    (k) => is(k) && !is(k - 1) && !is(k + 1),
  );
}

/** Numbers at one step. */
export type Point<Name extends string> = Record<Name, number | null> & {
  epoch: number;
  time: number;
};

export class History<Name extends string> {
  readonly time: number[] = [];
  readonly columns: Record<Name, (number | null)[]>;
  private epoch = 0;
  private began = Number.NEGATIVE_INFINITY;

  constructor(private readonly names: readonly Name[]) {
    const columns = names.map((name) => [name, [] as (number | null)[]] as const);
    this.columns = Object.fromEntries(columns) as Record<Name, (number | null)[]>;
  }

  /**
   * Adds the newest moment as the last point. It replaces the previous point if that began less than
   * SPACING_MS ago or has the same time: commands change a paused swarm, too.
   */
  add(newest: Point<Name>, now: number): void {
    const last = this.time.at(-1);
    if (last === undefined || newest.epoch !== this.epoch || newest.time <= last) {
      // After a reset or a restart time goes back: new points replace those from this time on.
      this.dropFrom(newest.time);
      this.epoch = newest.epoch;
      this.began = now;
    } else if (now - this.began < SPACING_MS) {
      this.drop(this.time.length - 1);
    } else {
      this.began = now;
    }
    this.time.push(newest.time);
    for (const name of this.names) {
      this.columns[name].push(newest[name]);
    }
    const surplus = this.time.length - MAX_POINTS;
    if (surplus > 0) {
      this.time.splice(0, surplus);
      for (const name of this.names) {
        this.columns[name].splice(0, surplus);
      }
    }
  }

  clear(): void {
    this.drop(0);
  }

  private dropFrom(time: number): void {
    const kept = this.time.findIndex((it) => it >= time);
    if (kept >= 0) {
      this.drop(kept);
    }
  }

  private drop(kept: number): void {
    this.time.length = kept;
    for (const name of this.names) {
      this.columns[name].length = kept;
    }
  }
}
