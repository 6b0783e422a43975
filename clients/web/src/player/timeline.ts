/** The frames of one run, or of a recording, over time. */
import type { Shown } from "./frames.ts";

export class Timeline {
  readonly frames: Shown[] = [];
  /** When each frame is played: its simulated time, which no reset sets back. */
  readonly times: number[] = [];
  readonly order: number[] = [];
  readonly drift: (number | null)[] = [];
  /** Why its last step failed. */
  fault: string | null = null;

  /** `total` is the time at which it ends, once all frames are there. */
  constructor(
    readonly dt: number,
    public total: number,
  ) {}

  add(frames: readonly Shown[]): void {
    for (const frame of frames) {
      const last = this.frames.at(-1);
      // After a reset the step is lower: as far on as the run is since.
      const steps = last && frame.step >= last.step ? frame.step - last.step : frame.step;
      this.times.push(this.end + Math.max(steps, last ? 1 : 0) * this.dt);
      this.frames.push(frame);
      this.order.push(frame.order);
      this.drift.push(frame.drift);
    }
  }

  /** The time of the first frame. */
  get start(): number {
    return this.times[0] ?? 0;
  }

  /** The time of the last frame so far. */
  get end(): number {
    return this.times.at(-1) ?? 0;
  }

  /** The index of the last frame that is not after a time; -1 if there is none. */
  at(time: number): number {
    let [low, high] = [0, this.times.length];
    while (low < high) {
      const middle = (low + high) >>> 1;
      if (this.times[middle]! <= time) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    return low - 1;
  }
}
