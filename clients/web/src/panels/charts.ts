/** Charts of order, drift, contacts and real-time factor over the swarm's time. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { el, say } from "../parts/dom.ts";
import { fixed } from "../parts/format.ts";
import { onTheme } from "../parts/theme.ts";
import { History, type Point, type Series } from "./history.ts";

const HEIGHT = 132;
/** Charts are drawn this often at most. */
const EVERY_MS = 250;

interface Kind {
  series: Series;
  title: string;
  about: string;
  digits: number;
  range?: [number, number];
  colour: string;
  dash?: number[];
}

const KINDS: Kind[] = [
  {
    series: "order",
    title: "order",
    about: "1 is all in one direction",
    digits: 3,
    range: [0, 1],
    colour: "--chart-1",
  },
  {
    series: "drift",
    title: "drift",
    about: "speed along the informed's direction",
    digits: 3,
    range: [-1, 1],
    colour: "--chart-2",
  },
  {
    series: "contacts",
    title: "contacts",
    about: "pairs near enough to constrain",
    digits: 0,
    colour: "--chart-3",
  },
  {
    series: "real_time_factor",
    title: "real-time factor",
    about: "time units a second",
    digits: 1,
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

  take(message: Point): void {
    if (this.history.add(message, performance.now())) {
      this.schedule();
    }
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
      "nobody is informed: no direction to drift in",
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
      series: [
        {},
        { stroke: () => colour(kind.colour), width: 1.6, points: { show: false }, spanGaps: false },
      ],
    };
    const plot = new uPlot(options, [[], []], place);
    this.charts.push({ kind, plot, now, none });
  }

  private schedule(): void {
    if (this.shown && !this.timer) {
      this.timer = setTimeout(() => this.draw(), EVERY_MS);
    }
  }

  private draw(): void {
    this.timer = undefined;
    const { time, columns } = this.history;
    for (const { kind, plot, now, none } of this.charts) {
      const column = columns[kind.series];
      plot.setData([time, column]);
      say(now, fixed(column.at(-1), kind.digits));
      none.hidden =
        kind.series !== "drift" || column.some((it) => it !== null) || time.length === 0;
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
