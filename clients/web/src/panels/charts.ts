/** Charts of order, drift, contacts and real-time factor over simulated time. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { callAll, el, setText } from "../ui/dom.ts";
import { fixed, signed } from "../ui/format.ts";
import { onTheme } from "../ui/theme.ts";
import { History, isolated, type Moment, type Series } from "./history.ts";

/** The minimum time between two redraws. */
const DRAW_INTERVAL_MS = 250;

interface Kind {
  series: Series;
  title: string;
  about: string;
  format(value: number | null): string;
  range?: [number, number];
  colour: string;
  dash?: number[];
}

const KINDS: Kind[] = [
  {
    series: "order",
    title: "order",
    about: "1: all headings equal",
    format: (it) => fixed(it, 3),
    range: [0, 1],
    colour: "--chart-1",
  },
  {
    series: "drift",
    title: "drift",
    about: "speed along the common direction of the informed",
    format: (it) => signed(it, 3),
    range: [-1, 1],
    colour: "--chart-2",
  },
  {
    series: "contacts",
    title: "contacts",
    about: "pairs near enough to constrain",
    format: (it) => fixed(it, 0),
    colour: "--chart-3",
  },
  {
    series: "real_time_factor",
    title: "real-time factor",
    about: "time units per second",
    format: (it) => fixed(it, 2),
    colour: "--chart-4",
  },
];

function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export class Charts {
  readonly element = el("div", { class: "charts" });
  readonly history = new History();
  private readonly charts: { kind: Kind; plot: uPlot; now: HTMLElement; none: HTMLElement }[] = [];
  private readonly ends: (() => void)[] = [];
  private timer: ReturnType<typeof setTimeout> | undefined;
  private drawnAt = Number.NEGATIVE_INFINITY;
  private shown = false;

  constructor() {
    for (const kind of KINDS) {
      this.addChart(kind);
    }
    const observer = new ResizeObserver(() => this.resize());
    observer.observe(this.element);
    // Charts outside the viewport are not drawn.
    const visibility = new IntersectionObserver((entries) => {
      this.shown = entries.some((entry) => entry.isIntersecting);
      this.schedule();
    });
    visibility.observe(this.element);
    this.ends.push(
      () => observer.disconnect(),
      () => visibility.disconnect(),
      onTheme(() => {
        for (const { plot } of this.charts) {
          plot.redraw(false);
        }
      }),
    );
  }

  /** Updates the captions at once, and the lines with the next redraw. */
  add(newest: Moment): void {
    this.history.add(newest, performance.now());
    for (const { kind, now, none } of this.charts) {
      const value = newest[kind.series];
      setText(now, kind.format(value));
      none.hidden = kind.series !== "drift" || this.history.columns.drift.some((it) => it !== null);
    }
    this.schedule();
  }

  end(): void {
    clearTimeout(this.timer);
    callAll(this.ends);
    for (const { plot } of this.charts) {
      plot.destroy();
    }
  }

  private addChart(kind: Kind): void {
    const now = el("output", {});
    const none = el(
      "p",
      { class: "none", hidden: true },
      "no individual is informed: the drift is undefined",
    );
    const caption = el("figcaption", { title: kind.about }, el("b", {}, kind.title), " ", now);
    const place = el("div", {
      role: "img",
      "aria-label": `${kind.title} over time: ${kind.about}`,
    });
    this.element.append(el("figure", { class: "chart" }, caption, place, none));
    const axis: uPlot.Axis = {
      stroke: () => colour("--soft-ink"),
      grid: { stroke: () => colour("--line"), width: 1 },
      ticks: { show: false },
      font: "11px system-ui, sans-serif",
      gap: 2,
    };
    // A single value without neighbours makes no line.
    const points: uPlot.Series.Points = {
      size: 5,
      fill: () => colour(kind.colour),
      filter: (plot, series) => isolated(plot.data[series] ?? []),
    };
    const options: uPlot.Options = {
      width: 240,
      height: 132,
      legend: { show: false },
      cursor: { show: false },
      scales: {
        x: { time: false },
        y: kind.range
          ? { range: kind.range }
          : { range: (_, __, most) => [0, Math.max(1, 1.1 * (most ?? 0))] },
      },
      axes: [
        { ...axis, size: 24, gap: 6, space: 44 },
        { ...axis, size: 36 },
      ],
      series: [{}, { stroke: () => colour(kind.colour), width: 1.6, points, spanGaps: false }],
    };
    const plot = new uPlot(options, [[], []], place);
    this.charts.push({ kind, plot, now, none });
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
    const { time, columns } = this.history;
    for (const { kind, plot } of this.charts) {
      plot.setData([time, columns[kind.series]]);
    }
  }

  private resize(): void {
    for (const { plot } of this.charts) {
      const { clientWidth: width, clientHeight: height } = plot.root.parentElement!;
      if (width > 40 && Math.abs(width - plot.width) + Math.abs(height - plot.height) > 1) {
        plot.setSize({ width, height });
      }
    }
  }
}
