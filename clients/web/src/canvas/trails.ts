/** Past positions of all individuals, at even intervals of simulated time. */
import type { Drawn } from "../wire/state.ts";
import type { Scene } from "./bodies.ts";

/** Time units between two kept positions. */
const SPACING = 0.2;
/** Positions kept of each individual. */
const MAX_LENGTH = 75;
/** The longest time of a trail, time units. */
export const MAX_TIME = SPACING * MAX_LENGTH;
/** Points of all trails in total. */
const BUDGET = 12_000;
/** Trails fade in this many shades; of more than MANY bodies in one, which draws four times as fast. */
const SHADES = 4;
const MANY = 250;
const DOT_PX = 1.5;

interface Past {
  time: number;
  x: Float64Array;
  y: Float64Array;
}

export class Trails {
  private past: Past[] = [];

  keep(state: Drawn): void {
    const last = this.past.at(-1);
    if (last && state.time - last.time < SPACING && state.time >= last.time) {
      return;
    }
    this.past.push({ time: state.time, x: state.x.slice(), y: state.y.slice() });
    const most = Math.max(
      3,
      Math.min(MAX_LENGTH, Math.floor(BUDGET / Math.max(1, state.x.length))),
    );
    if (this.past.length > most) {
      this.past.splice(0, this.past.length - most);
    }
  }

  /** The time of the newest positions. */
  get time(): number {
    return this.past.at(-1)?.time ?? Number.NEGATIVE_INFINITY;
  }

  clear(): void {
    this.past = [];
  }

  rebase(dx: number, dy: number): void {
    for (const { x, y } of this.past) {
      for (let i = 0; i < x.length; i += 1) {
        x[i]! += dx;
        y[i]! += dy;
      }
    }
  }

  /** Positions `limit` time units or more apart are drawn as dots without a line between them. */
  draw({ g, camera, colours }: Scene, limit: number): void {
    const { past } = this;
    const n = past[0]?.x.length ?? 0;
    const isNear = past.map((it, k) => k > 0 && Math.abs(it.time - past[k - 1]!.time) < limit);
    g.lineCap = "round";
    g.strokeStyle = colours.trail;
    g.lineWidth = 1;
    g.lineJoin = "bevel";
    const shades = n > MANY ? 1 : SHADES;
    const length = Math.ceil((past.length - 1) / shades);
    for (let shade = 0; shade < shades; shade += 1) {
      const first = shade * length;
      const last = Math.min(past.length - 1, first + length);
      g.globalAlpha = (0.75 * (shade + 1)) / shades;
      for (let i = 0; first < last && i < n; i += 1) {
        g.beginPath();
        for (let k = first; k <= last; k += 1) {
          const [left, top] = camera.toScreen(past[k]!.x[i]!, past[k]!.y[i]!);
          if (k > first && isNear[k]) {
            g.lineTo(left, top);
          } else {
            g.moveTo(left, top);
          }
          if (!isNear[k] && !isNear[k + 1]) {
            g.lineTo(left + DOT_PX, top);
          }
        }
        g.stroke();
      }
    }
    g.globalAlpha = 1;
  }
}
