/** Charts of order, drift, contacts and real-time factor over the swarm's time. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { el, say } from "../parts/dom.ts";
import { fixed, signed } from "../parts/format.ts";
import { onTheme } from "../parts/theme.ts";
import { alone, History, type Moment, type Series } from "./history.ts";

const HEIGHT = 132;
/** Charts are drawn this often at most. */
const EVERY_MS = 250;

interface Kind {
  series: Series;
  title: string;
  about: string;
  said(value: number | null): string;
  range?: [number, number];
  colour: string;
  dash?: number[];
}

const KINDS: Kind[] = [
  {
    series: "order",
    title: "order",
    about: "1 is all in one direction",
    said: (it) => fixed(it, 3),
    range: [0, 1],
    colour: "--chart-1",
  },
  {
    series: "drift",
    title: "drift",
    about: "speed along the informed's direction",
    said: (it) => signed(it, 3),
    range: [-1, 1],
    colour: "--chart-2",
  },
  {
    series: "contacts",
    title: "contacts",
    about: "pairs near enough to constrain",
    said: (it) => fixed(it, 0),
    colour: "--chart-3",
  },
  {
    series: "real_time_factor",
    title: "real-time factor",
    about: "time units a second",
    said: (it) => fixed(it, 2),
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
  private drawn = Number.NEGATIVE_INFINITY;
  private shown = false;

  constructor() {
    for (const kind of KINDS) {
      this.add(kind);
    }
    const observer = new ResizeObserver(() => this.resize());
    observer.observe(this.element);
    // A picture off the screen is not drawn.
    const sight = new IntersectionObserver((entries) => {
      this.shown = entries.some((entry) => entry.isIntersecting);
      this.schedule();
    });
    sight.observe(this.element);
    this.ends.push(
      () => observer.disconnect(),
      () => sight.disconnect(),
      onTheme(() => {
        for (const { plot } of this.charts) {
          plot.redraw(false);
        }
      }),
    );
  }

  /** Shows what is newest: the captions at once, the lines when they are next drawn. */
  take(newest: Moment): void {
    this.history.add(newest, performance.now());
    for (const { kind, now, none } of this.charts) {
      const value = newest[kind.series];
      say(now, kind.said(value));
      none.hidden = kind.series !== "drift" || this.history.columns.drift.some((it) => it !== null);
    }
    this.schedule();
  }

  end(): void {
    clearTimeout(this.timer);
    for (const end of this.ends) {
      end();
    }
    for (const { plot } of this.charts) {
      plot.destroy();
    }
  }

  private add(kind: Kind): void {
    const now = el("output", {});
    const none = el(
      "p",
      { class: "none", hidden: true },
      "no one is informed: there is no direction to drift in",
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
    // A line takes two points: one alone is a dot.
    const points: uPlot.Series.Points = {
      size: 5,
      fill: () => colour(kind.colour),
      filter: (plot, series) => alone(plot.data[series] ?? []),
    };
    const options: uPlot.Options = {
      width: 240,
      height: HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      scales: {
        x: { time: false },
        y: kind.range
          ? { range: kind.range }
          : { range: (_, __, most) => [0, Math.max(1, 1.1 * (most ?? 0))] },
      },
      axes: [
        { ...axis, size: 22 },
        { ...axis, size: 36 },
      ],
      series: [{}, { stroke: () => colour(kind.colour), width: 1.6, points, spanGaps: false }],
    };
    const plot = new uPlot(options, [[], []], place);
    this.charts.push({ kind, plot, now, none });
  }

  private schedule(): void {
    if (this.shown && !this.timer) {
      const rest = this.drawn + EVERY_MS - performance.now();
      this.timer = setTimeout(() => this.draw(), Math.max(0, rest));
    }
  }

  private draw(): void {
    this.timer = undefined;
    this.drawn = performance.now();
    const { time, columns } = this.history;
    for (const { kind, plot } of this.charts) {
      plot.setData([time, columns[kind.series]]);
    }
  }

  private resize(): void {
    for (const { plot } of this.charts) {
      const width = plot.root.parentElement?.clientWidth ?? 0;
      if (width > 40 && Math.abs(width - plot.width) > 1) {
        plot.setSize({ width, height: HEIGHT });
      }
    }
  }
}
