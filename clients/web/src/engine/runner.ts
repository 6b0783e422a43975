/** Executes a job in a worker, and knows how far it is. */
import type { FullSpec } from "./engine.ts";
import type { Frame, Job, Report } from "./job.ts";

export interface RunnerEvents {
  /** The run of this spec begins; null in place of it in a replay. */
  begun?(spec: FullSpec | null): void;
  /** The run is as far as `runner` tells; these frames are new. */
  progress(frames: Frame[]): void;
  finished(end: Extract<Report, { kind: "finished" }>): void;
  /** The job was rejected, or the engine failed. */
  failed(why: { message: string; details: Record<string, unknown> }): void;
}

/** Before this time the rate of a run is not known well enough. */
const MIN_RATE_MS = 300;

export class Runner {
  /** The present step, and the most steps that are taken; 0 before it begins. */
  step = 0;
  steps = 0;
  private start = 0;
  private began = 0;

  /** `worker` is a new one, which ends with the job. */
  constructor(
    private readonly worker: Worker,
    job: Job,
    private readonly events: RunnerEvents,
    private readonly now: () => number = () => performance.now(),
  ) {
    worker.onmessage = ({ data }: MessageEvent<Report>) => this.take(data);
    worker.onerror = (event) => {
      event.preventDefault();
      this.end();
      events.failed({ message: event.message || "the worker could not be started", details: {} });
    };
    worker.postMessage(job);
  }

  /** The part of the steps that is taken, 0 to 1. */
  get share(): number {
    return this.steps === 0 ? 0 : this.taken / this.steps;
  }

  /** The seconds until the end at the rate so far; null if that is not known yet. */
  get remaining(): number | null {
    const passed = this.now() - this.began;
    const { taken, steps } = this;
    if (taken === 0 || passed < MIN_RATE_MS) {
      return null;
    }
    return ((passed / taken) * (steps - taken)) / 1000;
  }

  private get taken(): number {
    return this.step - this.start;
  }

  /** Ends the worker: no event follows. */
  end(): void {
    this.worker.onmessage = null;
    this.worker.onerror = null;
    this.worker.terminate();
  }

  private take(report: Report): void {
    switch (report.kind) {
      case "begun":
        this.steps = report.steps;
        this.step = report.step;
        this.start = report.step;
        this.began = this.now();
        this.events.begun?.(report.spec);
        this.events.progress([]);
        break;
      case "progress":
        this.step = report.step;
        this.events.progress(report.frames);
        break;
      case "finished":
        this.end();
        this.events.finished(report);
        break;
      case "failed":
        this.end();
        this.events.failed(report);
        break;
    }
  }
}
