/** One chart: a caption with the newest value, and a line over simulated time. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { el } from "../ui/dom.ts";
import { ticks } from "../ui/format.ts";
import { isolated } from "./history.ts";

export interface Kind {
  title: string;
  about: string;
  format(value: number | null): string;
  /** The ends of the vertical axis; by default it begins at 0. */
  range?: [number, number] | "of values";
  colour: string;
  /** The text in place of a line without values. */
  none: string;
}

/** The part of the range of values that is left free above and below them. */
const MARGIN = 0.1;

function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function scaleOf(range: Kind["range"]): uPlot.Scale {
  if (Array.isArray(range)) {
    return { range };
  }
  if (range === undefined) {
    return { range: (_, __, most) => [0, Math.max(1, 1.1 * (most ?? 0))] };
  }
  return {
    range: (_, least, most) => {
      if (least === null || most === null) {
        return [0, 1];
      }
      const margin = MARGIN * (most - least) || Math.max(Math.abs(most), 1e-9) / 2;
      return [least - margin, most + margin];
    },
  };
}

/** The width of the vertical axis: 7 px a character beside a margin, so that no label is cut off. */
function widthOf(labels: string[] | null): number {
  return Math.max(42, 7 + 7 * Math.max(0, ...(labels ?? []).map((it) => it.length)));
}

export class Plot {
  readonly element: HTMLElement;
  readonly now = el("output", {});
  readonly none: HTMLElement;
  private readonly plot: uPlot;
  private readonly marker = el("i", { class: "marker" });
  /** The least end of the horizontal axis. */
  private span = 0;

  constructor(kind: Kind) {
    this.none = el("p", { class: "none", hidden: true }, kind.none);
    const caption = el("figcaption", { title: kind.about }, el("b", {}, kind.title), " ", this.now);
    const place = el("div", {
      role: "img",
      "aria-label": `${kind.title} over time: ${kind.about}`,
    });
    this.element = el("figure", { class: "chart" }, caption, place, this.none);
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
        x: { time: false, range: (_, least, most) => [least, Math.max(most, this.span)] },
        y: scaleOf(kind.range),
      },
      axes: [
        { ...axis, size: 24, gap: 6, space: 44 },
        { ...axis, size: (_, labels) => widthOf(labels), values: (_, splits) => ticks(splits) },
      ],
      series: [{}, { stroke: () => colour(kind.colour), width: 1.6, points, spanGaps: false }],
    };
    this.plot = new uPlot(options, [[], []], place);
  }

  draw(time: number[], values: (number | null)[]): void {
    this.plot.setData([time, values]);
  }

  /** Makes the horizontal axis at least this long, whatever is drawn. */
  setSpan(time: number): void {
    this.span = time;
  }

  /** Marks a time with a vertical line. */
  mark(time: number): void {
    const { plot, marker } = this;
    if (!marker.isConnected) {
      plot.over.append(marker);
    }
    const left = plot.valToPos(time, "x");
    marker.style.left = `${Number.isFinite(left) ? left : 0}px`;
  }

  /** Calls the listener with the time at which the chart is pressed. */
  onSeek(listener: (time: number) => void): void {
    this.plot.over.addEventListener("click", ({ offsetX }) =>
      listener(this.plot.posToVal(offsetX, "x")),
    );
  }

  redraw(): void {
    this.plot.redraw(false);
  }

  resize(): void {
    const { clientWidth: width, clientHeight: height } = this.plot.root.parentElement!;
    const { plot } = this;
    if (width > 40 && Math.abs(width - plot.width) + Math.abs(height - plot.height) > 1) {
      plot.setSize({ width, height });
    }
  }

  end(): void {
    this.plot.destroy();
    this.element.remove();
  }
}
