/** What the charts show: the newest numbers of a swarm over its time. */
import type { OrderMessage } from "../wire/messages.ts";

export const MOST_POINTS = 2000;
/** Wall time between two points: states may come fifty times a second. */
const SPACING_MS = 100;

export const SERIES = ["order", "drift", "contacts", "real_time_factor"] as const;
export type Series = (typeof SERIES)[number];

/** What a point is made of: an order message, or a state. */
export type Point = Pick<
  OrderMessage,
  "epoch" | "time" | "order" | "certificate" | "real_time_factor"
>;

export class History {
  readonly time: number[] = [];
  readonly columns: Record<Series, (number | null)[]> = {
    order: [],
    drift: [],
    contacts: [],
    real_time_factor: [],
  };
  private epoch = 0;
  private noted = Number.NEGATIVE_INFINITY;

  /** Adds a point; returns whether there is anything new. */
  add(message: Point, now: number): boolean {
    const last = this.time.at(-1);
    if (message.epoch !== this.epoch || (last !== undefined && message.time < last)) {
      // After a reset or a restart time goes back: what is told again replaces what was told.
      this.dropFrom(message.time);
      this.epoch = message.epoch;
      this.noted = Number.NEGATIVE_INFINITY;
    } else if (message.time === last || now - this.noted < SPACING_MS) {
      return false;
    }
    this.noted = now;
    this.time.push(message.time);
    this.columns.order.push(message.order.order);
    this.columns.drift.push(message.order.drift);
    this.columns.contacts.push(message.certificate.contacts);
    this.columns.real_time_factor.push(message.real_time_factor);
    const surplus = this.time.length - MOST_POINTS;
    if (surplus > 0) {
      this.time.splice(0, surplus);
      for (const name of SERIES) {
        this.columns[name].splice(0, surplus);
      }
    }
    return true;
  }

  private dropFrom(time: number): void {
    const kept = this.time.findIndex((it) => it >= time);
    if (kept >= 0) {
      this.time.length = kept;
      for (const name of SERIES) {
        this.columns[name].length = kept;
      }
    }
  }
}
