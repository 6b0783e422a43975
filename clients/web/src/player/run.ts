/** Executes the run of a file, and variants of it, and plays them. */
import type { FullSpec } from "../engine/engine.ts";
import type { Job } from "../engine/job.ts";
import { Runner } from "../engine/runner.ts";
import EngineWorker from "../engine/worker.ts?worker&inline";
import type { ClaimPanel, End } from "./claim.ts";
import { type Content, unpack } from "./file.ts";
import { Parameters } from "./parameters.ts";
import type { Stage } from "./stage.ts";
import { Timeline } from "./timeline.ts";

/** The time between two frames of a run, time units. */
const SPACING = 0.1;

/** Executes the run of the file, and the reader's variants. */
export class RunPlayer {
  readonly parameters: Parameters;
  private published: Timeline | null = null;
  private module: ArrayBuffer | null = null;
  private variant: Runner | null = null;

  constructor(
    private readonly content: Content,
    private readonly stage: Stage,
    private readonly panel: ClaimPanel,
  ) {
    this.parameters = new Parameters(content, {
      vary: (toml, change) => this.vary(toml, change),
      back: () => this.back(),
    });
  }

  /** Begins the run; returns the module. */
  async begin(module: string): Promise<ArrayBuffer | null> {
    const { content, panel, parameters, stage } = this;
    const { claim } = content;
    panel.say("computing …");
    panel.publish(claim ?? null);
    try {
      this.module = await unpack(module);
    } catch {
      panel.say("not computed: the engine in this file is damaged, or this browser is too old");
      return null;
    }
    const runner = this.start(content.files?.toml ?? "", {
      begun: (timeline, spec) => {
        this.published = timeline;
        parameters.offer(spec);
        stage.open(timeline);
      },
      progress: () => panel.progress(runner.step, runner.steps, runner.remaining),
      finished: (end) => {
        if (claim) {
          panel.compare(claim, end);
        } else {
          panel.say(`computed; this file claims no hash: ${end.state_hash}`);
        }
      },
      failed: (message) => panel.say(`not computed: ${message}`),
    });
    return this.module;
  }

  /** Shows the published run. */
  private back(): void {
    this.variant?.end();
    this.variant = null;
    this.panel.showVariant(false);
    if (this.published) {
      this.stage.open(this.published);
    }
  }

  private vary(toml: string, change: string): void {
    const { panel, parameters, stage } = this;
    this.variant?.end();
    const runner = this.start(toml, {
      begun: (timeline) => {
        panel.showVariant(true);
        stage.open(timeline);
      },
      progress: () => parameters.progress(runner.step, runner.steps),
      finished: ({ state_hash, fault }) =>
        parameters.say(
          `your variant, ${change}: ${fault ?? "computed"}. Nothing is claimed about it; its hash is ` +
            `${state_hash}`,
        ),
      failed: (message) => {
        this.back();
        parameters.say(`not computed: ${message}`);
      },
    });
    this.variant = runner;
  }

  private start(toml: string, events: RunEvents): Runner {
    const { content, stage } = this;
    const job: Job = {
      kind: "run",
      module: this.module!,
      files: { ...content.files!, toml },
      run: content.run?.index ?? 0,
      name: content.run?.name,
      spacing: SPACING,
    };
    let timeline: Timeline | null = null;
    const runner: Runner = new Runner(new EngineWorker(), job, {
      begun: (spec) => {
        timeline = new Timeline(spec!.dt, runner.steps * spec!.dt);
        events.begun(timeline, spec!);
      },
      progress: (frames) => {
        timeline?.add(frames);
        stage.grown();
        events.progress();
      },
      finished: (end) => {
        if (timeline) {
          timeline.total = timeline.end;
          timeline.fault = end.fault;
        }
        stage.grown();
        events.finished(end);
      },
      failed: ({ message }) => events.failed(message),
    });
    return runner;
  }
}

interface RunEvents {
  begun(timeline: Timeline, spec: FullSpec): void;
  progress(): void;
  finished(end: End): void;
  failed(message: string): void;
}
