/** Charts of order, drift, contacts, real-time factor and chosen measures over simulated time. */
import { callAll, el, setText } from "../ui/dom.ts";
import { onTheme } from "../ui/theme.ts";
import { ChartMenu } from "./chart_menu.ts";
import { History, type Moment, SERIES, type Series } from "./history.ts";
import { MeasureCharts } from "./measure_charts.ts";
import { Plot } from "./plot.ts";
import { KINDS } from "./series.ts";

/** The minimum time between two redraws. */
const DRAW_INTERVAL_MS = 250;

export class Charts {
  readonly element: HTMLElement;
  private readonly grid = el("div", { class: "charts" });
  private readonly history = new History(SERIES);
  private readonly plots = new Map<Series, Plot>();
  private readonly measures: MeasureCharts;
  private readonly ends: (() => void)[] = [];
  private timer: ReturnType<typeof setTimeout> | undefined;
  private drawnAt = Number.NEGATIVE_INFINITY;
  private shown = false;

  constructor(swarm: string) {
    this.measures = new MeasureCharts(swarm, this.grid);
    const titles = new Map(SERIES.map((name) => [name as string, KINDS[name].title]));
    const menu = new ChartMenu(swarm, titles, (chosen) => this.choose(chosen));
    this.element = el("section", { class: "chart-section" }, menu.element, this.grid);
    this.choose(menu.chosen);
    const observer = new ResizeObserver(() => this.resize());
    observer.observe(this.grid);
    // Charts outside the viewport are not drawn.
    const visibility = new IntersectionObserver((entries) => {
      this.shown = entries.some((entry) => entry.isIntersecting);
      this.schedule();
    });
    visibility.observe(this.grid);
    this.ends.push(
      () => observer.disconnect(),
      () => visibility.disconnect(),
      onTheme(() => {
        for (const plot of this.all()) {
          plot.redraw();
        }
      }),
    );
  }

  /** Updates the captions at once, and the lines with the next redraw. */
  add(newest: Moment): void {
    this.history.add(newest, performance.now());
    for (const name of this.plots.keys()) {
      this.caption(name);
    }
    this.measures.changed();
    this.schedule();
  }

  /** Forgets the values of another swarm of this name. */
  clear(): void {
    this.history.clear();
    this.measures.clear();
  }

  end(): void {
    clearTimeout(this.timer);
    callAll(this.ends);
    this.measures.end();
    for (const plot of this.plots.values()) {
      plot.end();
    }
  }

  private all(): Plot[] {
    return [...this.plots.values(), ...this.measures.plots()];
  }

  /** Shows the charts of these names: series, and measures. */
  private choose(chosen: readonly string[]): void {
    for (const name of SERIES) {
      const plot = this.plots.get(name);
      if (chosen.includes(name) && !plot) {
        this.plots.set(name, new Plot(KINDS[name]));
        this.caption(name);
      } else if (!chosen.includes(name) && plot) {
        plot.end();
        this.plots.delete(name);
      }
    }
    // In the order of the menu.
    this.grid.prepend(...SERIES.flatMap((name) => this.plots.get(name)?.element ?? []));
    this.measures.choose(chosen.filter((name) => !(SERIES as readonly string[]).includes(name)));
    this.resize();
    this.schedule();
  }

  private caption(name: Series): void {
    const column = this.history.columns[name];
    const { now, none } = this.plots.get(name)!;
    setText(now, KINDS[name].format(column.at(-1) ?? null));
    none.hidden = name !== "drift" || column.length === 0 || column.some((it) => it !== null);
  }

  private schedule(): void {
    if (this.shown && !this.timer) {
      const rest = this.drawnAt + DRAW_INTERVAL_MS - performance.now();
      this.timer = setTimeout(() => this.draw(), Math.max(0, rest));
    }
  }

  private draw(): void {
    this.timer = undefined;
    this.drawnAt = performance.now();
    for (const [name, plot] of this.plots) {
      plot.draw(this.history.time, this.history.columns[name]);
    }
    this.measures.draw();
  }

  private resize(): void {
    for (const plot of this.all()) {
      plot.resize();
    }
  }
}
