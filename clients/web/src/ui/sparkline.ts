/** A small line chart of numbers between 0 and 1. */
import { svg } from "./dom.ts";

const WIDTH = 120;
const HEIGHT = 28;

export class Sparkline {
  readonly element: SVGElement;
  private readonly line = svg("polyline", { fill: "none", "vector-effect": "non-scaling-stroke" });

  constructor() {
    const box = `0 0 ${WIDTH} ${HEIGHT}`;
    // At an order of 2/3 and above a swarm counts as ordered.
    const y = String((HEIGHT - 2) / 3 + 1);
    const mark = svg("line", { class: "mark", x1: "0", x2: String(WIDTH), y1: y, y2: y });
    const props = {
      class: "sparkline",
      viewBox: box,
      preserveAspectRatio: "none",
      "aria-hidden": "true",
    };
    this.element = svg("svg", props, mark, this.line);
  }

  /** With fewer than `least` values the line is shorter than the chart. */
  show(values: readonly number[], least: number): void {
    const last = values.length - 1;
    const apart = WIDTH / (Math.max(least, values.length) - 1);
    const points = values.map((value, k) => {
      const x = WIDTH - (last - k) * apart;
      return `${x.toFixed(1)},${(HEIGHT - 1 - value * (HEIGHT - 2)).toFixed(1)}`;
    });
    this.line.setAttribute("points", points.join(" "));
  }
}
