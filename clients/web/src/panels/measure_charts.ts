/** Charts of measures, whose values the daemon computes. */
import { setText } from "../ui/dom.ts";
import { brief, fixed } from "../ui/format.ts";
import { get, RequestError } from "../wire/http.ts";
import type { Measures, Reply } from "../wire/messages.ts";
import { History } from "./history.ts";
import { type Kind, Plot } from "./plot.ts";

/** The minimum time between two requests. */
const REQUEST_INTERVAL_MS = 500;
/** The errors after which the same request may succeed, and the time until it is sent again. */
const PASSING = ["busy", "deadline_exceeded", "no_reply"];
const RETRY_MS = 2000;

const UNDEFINED = "undefined for this group";

interface Chart {
  plot: Plot;
  history: History<"value">;
}

function kindOf(name: string): Kind {
  const isShare = ["nematic", "milling", "front"].includes(name);
  return {
    title: name,
    about: "a measure of the daemon",
    format: (it) => (isShare ? fixed(it, 3) : brief(it)),
    range: isShare ? [0, 1] : "of values",
    colour: "--chart-1",
    none: UNDEFINED,
  };
}

export class MeasureCharts {
  private readonly charts = new Map<string, Chart>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private requestedAt = Number.NEGATIVE_INFINITY;
  /** Whether the swarm has changed since the last request. */
  private isStale = true;
  private isRequesting = false;
  private isEnded = false;

  constructor(
    private readonly swarm: string,
    private readonly grid: HTMLElement,
  ) {}

  plots(): Plot[] {
    return [...this.charts.values()].map((chart) => chart.plot);
  }

  /** Shows the charts of these measures. */
  choose(names: readonly string[]): void {
    for (const [name, { plot }] of this.charts) {
      if (!names.includes(name)) {
        plot.end();
        this.charts.delete(name);
      }
    }
    for (const name of names) {
      if (!this.charts.has(name)) {
        const plot = new Plot(kindOf(name));
        this.charts.set(name, { plot, history: new History(["value"]) });
        this.grid.append(plot.element);
        this.isStale = true;
      }
    }
    this.schedule();
  }

  /** The swarm has a new state: its measures are requested within half a second. */
  changed(): void {
    this.isStale = true;
    this.schedule();
  }

  clear(): void {
    for (const { history } of this.charts.values()) {
      history.clear();
    }
    this.changed();
  }

  draw(): void {
    for (const { plot, history } of this.charts.values()) {
      plot.draw(history.time, history.columns.value);
    }
  }

  end(): void {
    this.isEnded = true;
    clearTimeout(this.timer);
    this.choose([]);
  }

  private schedule(): void {
    const isIdle = !this.timer && !this.isRequesting && !this.isEnded;
    if (isIdle && this.isStale && this.charts.size > 0 && !document.hidden) {
      const rest = this.requestedAt + REQUEST_INTERVAL_MS - performance.now();
      this.timer = setTimeout(() => void this.request(), Math.max(0, rest));
    }
  }

  private async request(): Promise<void> {
    this.timer = undefined;
    if (this.charts.size === 0) {
      return;
    }
    this.requestedAt = performance.now();
    this.isStale = false;
    this.isRequesting = true;
    const names = [...this.charts.keys()].map(encodeURIComponent).join(",");
    try {
      this.show(await get<Measures>(this.swarm, `measures?names=${names}`));
    } catch (error) {
      this.fail(error instanceof RequestError ? error.message : String(error));
      if (error instanceof RequestError && PASSING.includes(error.code)) {
        // No other state may come.
        this.isStale = true;
        this.requestedAt = performance.now() + RETRY_MS - REQUEST_INTERVAL_MS;
      }
    } finally {
      this.isRequesting = false;
      this.schedule();
    }
  }

  private show({ epoch, time, result }: Reply<Measures>): void {
    for (const { name, value, unit } of result.measures) {
      const chart = this.charts.get(name);
      if (!chart) {
        continue;
      }
      const { plot, history } = chart;
      history.add({ epoch, time, value }, performance.now());
      const text = kindOf(name).format(value);
      setText(plot.now, value === null || unit === "1" ? text : `${text} ${unit}`);
      setText(plot.none, UNDEFINED);
      plot.none.hidden = history.columns.value.some((it) => it !== null);
    }
    this.draw();
  }

  private fail(message: string): void {
    for (const { plot } of this.charts.values()) {
      setText(plot.none, message);
      plot.none.hidden = false;
    }
  }
}
