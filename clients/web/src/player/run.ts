/** Executes the run of a file, and variants of it, and plays them. */
import type { Job } from "../engine/job.ts";
import { Runner } from "../engine/runner.ts";
import EngineWorker from "../engine/worker.ts?worker&inline";
import type { ClaimPanel, End } from "./claim.ts";
import { type Content, unpack } from "./file.ts";
import { Parameters } from "./parameters.ts";
import type { Stage } from "./stage.ts";
import { Timeline } from "./timeline.ts";
import { valueIn } from "./variant.ts";

/** The time between two frames of a run, time units. */
const SPACING = 0.1;
/** The time step of a spec without one. */
const USUAL_DT = 0.02;

/** Executes the run of the file, and the reader's variants. */
export class RunPlayer {
  readonly parameters: Parameters;
  private readonly published: Timeline;
  private module: ArrayBuffer | null = null;
  private variant: Runner | null = null;

  constructor(
    private readonly content: Content,
    private readonly stage: Stage,
    private readonly panel: ClaimPanel,
  ) {
    this.parameters = new Parameters(content, {
      vary: (toml, change) => this.vary(toml, change),
      back: () => {
        this.variant?.end();
        this.variant = null;
        panel.showVariant(false);
        stage.open(this.published);
      },
    });
    this.published = this.timelineOf(content.files?.toml ?? "");
  }

  /** Begins the run; returns the module. */
  async begin(module: string): Promise<ArrayBuffer | null> {
    const { content, panel, published, stage } = this;
    const { claim } = content;
    panel.say("computing …");
    panel.publish(claim ?? null);
    try {
      this.module = await unpack(module);
    } catch {
      panel.say("not computed: the engine in this file is damaged, or this browser is too old");
      return null;
    }
    stage.open(published);
    const runner = this.start(content.files?.toml ?? "", published, {
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

  private vary(toml: string, change: string): void {
    const { panel, parameters, stage } = this;
    this.variant?.end();
    panel.showVariant(true);
    const timeline = this.timelineOf(toml);
    stage.open(timeline);
    const runner = this.start(toml, timeline, {
      progress: () => parameters.progress(runner.step, runner.steps),
      finished: ({ state_hash, fault }) =>
        parameters.say(
          `your variant, ${change}: ${fault ?? "computed"}. Nothing is claimed about it; its hash is ` +
            `${state_hash}`,
        ),
      failed: (message) => parameters.say(`not computed: ${message}`),
    });
    this.variant = runner;
  }

  private timelineOf(toml: string): Timeline {
    const { spec } = this.content;
    return new Timeline(spec?.dt ?? valueIn(toml, "dt") ?? USUAL_DT, 0);
  }

  private start(
    toml: string,
    timeline: Timeline,
    events: { progress(): void; finished(end: End): void; failed(message: string): void },
  ): Runner {
    const { content, stage } = this;
    const job: Job = {
      kind: "run",
      module: this.module!,
      files: { ...content.files!, toml },
      run: content.run?.index ?? 0,
      spacing: Math.max(1, Math.round(SPACING / timeline.dt)),
    };
    const runner: Runner = new Runner(new EngineWorker(), job, {
      progress: (frames) => {
        timeline.total = runner.steps * timeline.dt;
        timeline.add(frames);
        stage.grown();
        events.progress();
      },
      finished: (end) => {
        timeline.total = timeline.end;
        timeline.fault = end.fault;
        stage.grown();
        events.finished(end);
      },
      failed: ({ message }) => events.failed(message),
    });
    return runner;
  }
}
