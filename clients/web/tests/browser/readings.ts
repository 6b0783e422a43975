/** Reads everything that the page of a swarm shows, and compares it with what the daemon has. */
import type { Page } from "playwright-core";
import type { Daemon } from "./daemon.ts";

/** What the page of a swarm shows. */
interface Shown {
  title: string;
  link: string;
  phase: string;
  missing: boolean;
  button: string;
  may_step: boolean;
  rate: string;
  numbers: Record<string, string>;
  /** Of each chart the caption, and the last point in the units of its axes and of a pixel. */
  charts: Record<string, { caption: string; last: LastPoint | null }>;
  /** The shown value, and that in the field if there is one. */
  parameters: Record<string, { value: string; field: string | null }>;
  conditions: string[];
  events: number[];
  label: string;
  selection: string;
  scale: number;
  size: [number, number];
  segments: Segment[];
  position: string | null;
  slider: number | null;
}

interface LastPoint {
  time: number;
  value: number;
  /** What a pixel is worth. */
  time_px: number;
  value_px: number;
}

/** A line of one picture on the screen: from, to, and its colour. */
export type Segment = [number, number, number, number, string];

/** Runs in the page: records what is drawn on its canvases. */
export function recordDrawing(): void {
  const frames = { now: [] as Segment[], last: [] as Segment[], count: 0 };
  interface Chart {
    labels: [string, number, number][];
    end: [number, number] | null;
    size: [number, number];
  }
  const charts = new Map<HTMLCanvasElement, Chart>();
  Object.assign(globalThis, { frames, charts });
  const context = CanvasRenderingContext2D.prototype;
  const { beginPath, moveTo, lineTo, stroke, fillRect, clearRect, fillText, fill } = context;
  let path: Segment[] = [];
  let at: [number, number] = [0, 0];
  const chartOf = (g: CanvasRenderingContext2D) => {
    const found = charts.get(g.canvas) ?? { labels: [], end: null, size: [0, 0] };
    charts.set(g.canvas, found);
    return found;
  };
  const ends = new WeakMap<Path2D, [number, number]>();
  const { lineTo: pathLineTo, arc: pathArc } = Path2D.prototype;
  Object.assign(Path2D.prototype, {
    lineTo(this: Path2D, x: number, y: number) {
      ends.set(this, [x, y]);
      pathLineTo.call(this, x, y);
    },
    arc(this: Path2D, ...args: Parameters<typeof pathArc>) {
      ends.set(this, [args[0], args[1]]);
      pathArc.apply(this, args);
    },
  });
  const isPicture = (g: CanvasRenderingContext2D) => g.canvas.classList.contains("picture");
  Object.assign(context, {
    beginPath(this: CanvasRenderingContext2D) {
      path = [];
      beginPath.call(this);
    },
    moveTo(this: CanvasRenderingContext2D, x: number, y: number) {
      at = [x, y];
      moveTo.call(this, x, y);
    },
    lineTo(this: CanvasRenderingContext2D, x: number, y: number) {
      if (isPicture(this)) {
        path.push([...at, x, y, ""]);
      }
      at = [x, y];
      lineTo.call(this, x, y);
    },
    fillRect(this: CanvasRenderingContext2D, ...args: Parameters<typeof fillRect>) {
      // The picture begins with its ground.
      if (isPicture(this) && args[0] === 0 && args[1] === 0 && args[2] > 100) {
        frames.now = [];
        frames.count += 1;
      }
      fillRect.apply(this, args);
    },
    stroke(this: CanvasRenderingContext2D, line?: Path2D) {
      if (line) {
        const end = ends.get(line);
        if (end) {
          chartOf(this).end = end;
        }
        stroke.call(this, line);
        return;
      }
      if (isPicture(this)) {
        frames.now.push(
          ...path.map((it): Segment => [it[0], it[1], it[2], it[3], String(this.strokeStyle)]),
        );
      }
      (stroke as () => void).call(this);
    },
    fill(this: CanvasRenderingContext2D, ...args: unknown[]) {
      const [points] = args;
      if (points instanceof Path2D && !isPicture(this)) {
        const end = ends.get(points);
        const chart = chartOf(this);
        // A value without neighbours is a point.
        if (end && (!chart.end || end[0] >= chart.end[0])) {
          chart.end = end;
        }
      }
      (fill as (...all: unknown[]) => void).apply(this, args);
    },
    clearRect(this: CanvasRenderingContext2D, ...args: Parameters<typeof clearRect>) {
      charts.set(this.canvas, { labels: [], end: null, size: [args[2], args[3]] });
      clearRect.apply(this, args);
    },
    fillText(this: CanvasRenderingContext2D, text: string, x: number, y: number, width?: number) {
      if (!isPicture(this)) {
        const { e, f, a } = this.getTransform();
        chartOf(this).labels.push([text, a * x + e, a * y + f]);
      }
      fillText.call(this, text, x, y, ...(width === undefined ? [] : ([width] as const)));
    },
  });
}

/** Runs in the page: reads it. */
function readShown(): Shown {
  const { frames, charts } = globalThis as unknown as {
    frames: { now: Segment[] };
    charts: Map<
      HTMLCanvasElement,
      { labels: [string, number, number][]; end: [number, number] | null }
    >;
  };
  const all = (selector: string) => [...document.querySelectorAll<HTMLElement>(selector)];
  const text = (selector: string) => document.querySelector(selector)?.textContent ?? "";
  const field = (label: string) =>
    all("label").find((it) => it.firstElementChild?.textContent?.startsWith(label))
      ?.lastElementChild as HTMLInputElement | undefined;
  /** The linear map through the outermost two labels: a value, and that of a pixel. */
  const read = (labels: [number, number][], at: number): [number, number] | null => {
    const sorted = labels.filter(([value]) => Number.isFinite(value)).sort((a, b) => a[0] - b[0]);
    const [first, last] = [sorted[0], sorted.at(-1)];
    if (!first || !last || first[0] === last[0]) {
      return null;
    }
    const px = (last[0] - first[0]) / (last[1] - first[1]);
    return [first[0] + (at - first[1]) * px, Math.abs(px)];
  };
  const lastPoint = (canvas: HTMLCanvasElement | null): LastPoint | null => {
    const chart = canvas && charts.get(canvas);
    if (!chart?.end) {
      return null;
    }
    const [x, y] = chart.end;
    const value = (it: string) => Number(it.replace("−", "-").replaceAll(",", "") || Number.NaN);
    // The labels of the horizontal axis are in one row below, those of the vertical axis in a column.
    const row = Math.max(...chart.labels.map((it) => it[2]));
    const below = chart.labels.filter((it) => it[2] === row);
    const beside = chart.labels.filter((it) => it[2] !== row);
    const time = read(
      below.map((it) => [value(it[0]), it[1]]),
      x,
    );
    const height = read(
      beside.map((it) => [value(it[0]), it[2]]),
      y,
    );
    return time && height
      ? { time: time[0], time_px: time[1], value: height[0], value_px: height[1] }
      : null;
  };
  const canvas = document.querySelector<HTMLCanvasElement>("canvas.picture");
  const playback = document.querySelector<HTMLElement>(".playback");
  const isPlayback = playback !== null && !playback.hidden;
  return {
    title: document.title,
    link: location.hash,
    phase: document.querySelector<HTMLElement>(".page-head .phase")?.dataset.phase ?? "",
    missing: document.querySelector(".view.dimmed") !== null,
    button: text("button.wide"),
    may_step: !all("form button")
      .find((it) => it.textContent === "Step")
      ?.matches(":disabled"),
    rate: field("rate")?.value ?? "",
    numbers: Object.fromEntries(
      all("dd[data-number]").map((it) => [it.dataset.number, it.textContent]),
    ),
    charts: Object.fromEntries(
      all(".chart").map((it) => [
        it.querySelector("figcaption b")?.textContent,
        {
          caption: it.querySelector("output")?.textContent ?? "",
          last: lastPoint(it.querySelector("canvas")),
        },
      ]),
    ),
    parameters: Object.fromEntries(
      all(".parameter").map((it) => [
        it.querySelector("b")?.textContent,
        {
          value: it.querySelector("output")?.textContent ?? "",
          field:
            it.querySelector<HTMLInputElement>("input:not([type=checkbox]):not(.extra), select")
              ?.value ?? null,
        },
      ]),
    ),
    conditions: all(".waiting li code").map((it) => it.textContent ?? ""),
    events: all(".events li").map((it) => Number(it.dataset.number)),
    label: canvas?.getAttribute("aria-label") ?? "",
    selection: text(".selection"),
    scale: Number(canvas?.dataset.scale),
    size: [canvas?.clientWidth ?? 0, canvas?.clientHeight ?? 0],
    segments: frames.now,
    position: isPlayback ? text(".playback output") : null,
    slider: isPlayback ? (playback.querySelector("input")?.valueAsNumber ?? null) : null,
  };
}

/** A picture: the pixels per body size, its size, and all its lines. */
export async function picture(page: Page): Promise<Pick<Shown, "scale" | "size" | "segments">> {
  const { scale, size, segments } = await page.evaluate(readShown);
  return { scale, size, segments };
}

interface Numbers {
  order: number;
  direction: number | null;
  drift: number | null;
}

export interface StateJson {
  step: number;
  time: number;
  epoch: number;
  origin: [number, number];
  id: number[];
  x: number[];
  y: number[];
  alpha: number[];
  weight: number[];
}

interface Status {
  phase: string;
  step: number;
  time: number;
  result: {
    n: number;
    informed: number;
    rate: number | null;
    order: Numbers;
    certificate: { contacts: number };
    conditions?: { condition: string }[];
    replay: { position: number; duration: number } | null;
  };
}

interface ParameterList {
  result: { parameters: { name: string; value: unknown }[] };
}

interface EventsPage {
  result: { events: { number: number }[] };
}

interface Measures {
  result: { measures: { name: string; value: number | null }[] };
}

const minus = (text: string) => (/^-0\.?0*$/.test(text) ? text.slice(1) : text.replace("-", "−"));
const digits = (value: number | null, count: number) =>
  value === null ? "–" : minus(value.toFixed(count));
const plus = (value: number | null, count: number) =>
  `${value !== null && Number(value.toFixed(count)) > 0 ? "+" : ""}${digits(value, count)}`;

/** Everything in which the page of a swarm differs from the daemon; nothing if they agree. */
export async function differences(page: Page, daemon: Daemon, swarm: string): Promise<string[]> {
  const before = await daemon.get<Status>(`${swarm}/get/status`);
  const shown = await page.evaluate(readShown);
  const status = await daemon.get<Status>(`${swarm}/get/status`);
  const { result } = status;
  const found: string[] = [];
  const same = (what: string, is: unknown, wanted: unknown) => {
    if (JSON.stringify(is) !== JSON.stringify(wanted)) {
      found.push(`${what} is ${JSON.stringify(is)}, not ${JSON.stringify(wanted)}`);
    }
  };
  same("title", shown.title, `${swarm} – jostle`);
  same("link", shown.link, `#/swarm/${swarm}`);
  same("missing", shown.missing, false);
  same("phase", shown.phase, status.phase);
  same("button", shown.button, status.phase === "running" ? "❚❚ Pause" : "▶ Run");
  same("may step", shown.may_step, status.phase === "paused");
  same("rate", shown.rate, result.rate === null ? "" : String(result.rate));

  const events = await daemon.get<EventsPage>(`${swarm}/get/events?after=0&limit=256`);
  same("events", shown.events, events.result.events.map((it) => it.number).reverse());
  same(
    "conditions",
    shown.conditions,
    (result.conditions ?? []).map((it) => it.condition),
  );
  same("n", shown.numbers.n, String(result.n));
  same("informed", shown.numbers.informed, String(result.informed));
  const says = `${swarm}: ${result.n} individual${result.n === 1 ? "" : "s"}, ${result.informed} informed, ${status.phase}`;
  same("label", shown.label.startsWith(says), true);

  const { parameters } = (await daemon.get<ParameterList>(`${swarm}/get/parameters`)).result;
  for (const { name, value } of parameters) {
    const kind = typeof value === "object" && value ? (value as { kind: string }).kind : value;
    const row = shown.parameters[name];
    const text = name === "rate" && value === null ? "as fast as possible" : String(kind);
    same(`value of ${name}`, row?.value.startsWith(text), true);
    if (row && row.field !== null) {
      same(`field of ${name}`, row.field, String(kind));
    }
  }
  if (status.phase === "running") {
    // What is shown goes on: it is not older than what the daemon had before.
    if (result.rate !== null && Number(shown.numbers.step) < before.step - 100) {
      found.push(`step is ${shown.numbers.step}, not ${before.step}`);
    }
    return found;
  }
  const { order, certificate, replay } = result;
  same("step", shown.numbers.step, String(status.step));
  same("order", shown.numbers.order, digits(order.order, 3));
  same("drift", shown.numbers.drift, plus(order.drift, 3));
  same("contacts", shown.numbers.contacts, String(certificate.contacts));
  same("real-time factor", shown.numbers["real-time factor"], "–");
  if (order.direction !== null) {
    const degrees = digits((order.direction * 180) / Math.PI, 1);
    same("direction", shown.numbers.direction?.startsWith(`${degrees}°`), true);
  }
  same("label", shown.label.endsWith(`order ${digits(order.order, 2)}`), true);
  if (replay) {
    const share = replay.position / replay.duration;
    same("slider", Math.abs((shown.slider ?? -1) - 1000 * share) < 1, true);
    same(
      "position",
      shown.position,
      `${replay.position.toFixed(2)} of ${replay.duration.toFixed(2)}`,
    );
  } else {
    same("slider", shown.slider, null);
  }
  await compareCharts(daemon, swarm, shown, status, found);
  found.push(
    ...comparePicture(shown, await daemon.get<StateJson>(`${swarm}/state?format=json`), parameters),
  );
  return found;
}

/** The labels of an axis and the ends of lines are at whole pixels. */
const AXIS_PX = 4;
/** The measures that are shown with three decimals. */
const SHARES = ["nematic", "milling", "front"];

/** Compares the captions and the last points of the charts. */
async function compareCharts(
  daemon: Daemon,
  swarm: string,
  shown: Shown,
  { time, result }: Status,
  found: string[],
): Promise<void> {
  const values: Record<string, [number | null, string]> = {
    order: [result.order.order, digits(result.order.order, 3)],
    drift: [result.order.drift, plus(result.order.drift, 3)],
    contacts: [result.certificate.contacts, String(result.certificate.contacts)],
    "real-time factor": [null, "–"],
  };
  const measured = Object.keys(shown.charts).filter((it) => !(it in values));
  if (measured.length > 0) {
    const names = measured.map(encodeURIComponent).join(",");
    const { measures } = (await daemon.get<Measures>(`${swarm}/get/measures?names=${names}`))
      .result;
    for (const { name, value } of measures) {
      const text = SHARES.includes(name) ? digits(value, 3) : String(Number(value?.toPrecision(4)));
      values[name] = [value, value === null ? "–" : text];
    }
  }
  for (const [name, { caption, last }] of Object.entries(shown.charts)) {
    const [value, text] = values[name]!;
    if (caption.split(" ")[0] !== text) {
      found.push(`caption of ${name} is ${caption}, not ${text}`);
    }
    if (value === null || last === null) {
      continue;
    }
    if (Math.abs(last.time - time) > AXIS_PX * last.time_px) {
      found.push(`chart ${name} ends at t = ${last.time}, not ${time}`);
    }
    if (Math.abs(last.value - value) > AXIS_PX * last.value_px) {
      found.push(`chart ${name} ends at ${last.value}, not ${value}`);
    }
  }
}

const PIXEL = 1;

/** Compares where bodies are drawn, up to the place of the camera, and which look informed. */
function comparePicture(
  { segments, scale, size }: Shown,
  { x, y, alpha, weight }: StateJson,
  parameters: ParameterList["result"]["parameters"],
): string[] {
  const pi1 = Number(parameters.find((it) => it.name === "pi1")?.value);
  // A body of length l and width w, with (l + w) / 2 = 1, has an axis of length l - w.
  const axis = ((2 * (pi1 - 1)) / (1 + pi1)) * scale;
  const places = x.map((_, i) => {
    const [right, up] = [(axis / 2) * Math.cos(alpha[i]!), (axis / 2) * Math.sin(alpha[i]!)];
    return [scale * x[i]! - right, -scale * y[i]! + up, scale * x[i]! + right, -scale * y[i]! - up];
  });
  const near = (it: Segment, [a, b, c, d]: number[], dx: number, dy: number) =>
    Math.abs(it[0] - a! - dx) < PIXEL &&
    Math.abs(it[1] - b! - dy) < PIXEL &&
    Math.abs(it[2] - c! - dx) < PIXEL &&
    Math.abs(it[3] - d! - dy) < PIXEL;
  let best = "no body is drawn as the state has it";
  let least = Number.POSITIVE_INFINITY;
  for (const first of segments.slice(0, 400)) {
    for (const [k, place] of places.entries()) {
      const [dx, dy] = [first[0] - place[0]!, first[1] - place[1]!];
      if (!near(first, place, dx, dy)) {
        continue;
      }
      const missing: number[] = [];
      const colours: [Set<string>, Set<string>] = [new Set(), new Set()];
      places.forEach((it, i) => {
        const inside =
          [it[0]! + dx, it[2]! + dx].every((at) => at > 0 && at < size[0]) &&
          [it[1]! + dy, it[3]! + dy].every((at) => at > 0 && at < size[1]);
        const body = segments.filter((segment) => near(segment, it, dx, dy)).at(-1);
        if (body) {
          colours[weight[i]! > 0 ? 1 : 0].add(body[4]);
        } else if (inside) {
          missing.push(i);
        }
      });
      const mixed = [...colours[0]].filter((it) => colours[1].has(it)).length;
      if (missing.length === 0 && mixed === 0) {
        return [];
      }
      if (missing.length < least) {
        least = missing.length;
        best = `picture: ${missing.length} bodies are elsewhere; ${mixed} colours are of informed and others; from ${k}`;
      }
    }
  }
  return [best];
}
