/** The picture, the numbers and the charts of a timeline, and what plays it. */
import { MAX_TIME } from "../canvas/trails.ts";
import { View } from "../canvas/view.ts";
import { Plot } from "../panels/plot.ts";
import { KINDS } from "../panels/series.ts";
import { Toolbar } from "../panels/toolbar.ts";
import { button, el, setText } from "../ui/dom.ts";
import { fixed, grouped, plural, signed, time } from "../ui/format.ts";
import { onTheme } from "../ui/theme.ts";
import type { Drawn } from "../wire/state.ts";
import type { Shown } from "./frames.ts";
import type { Timeline } from "./timeline.ts";

/** The layers that are switched by buttons. */
const LAYERS = ["headings", "trails", "contacts", "clusters"] as const;
/** Time units a second. */
const RATES = [0.5, 1, 2, 5, 10, 20, 50];
const USUAL_RATE = 5;
/** The minimum time between two redraws of the charts. */
const DRAW_INTERVAL_MS = 250;
/** Steps of the slider. */
const STEPS = 1000;

const reduced = matchMedia("(prefers-reduced-motion: reduce)");

export class Stage {
  readonly element: HTMLElement;
  private readonly view: View;
  private readonly toolbar: Toolbar;
  private readonly play = button("", () => this.toggle(), "primary play");
  private readonly slider = el("input", {
    type: "range",
    min: "0",
    max: String(STEPS),
    step: "any",
    value: "0",
    "aria-label": "time",
  });
  private readonly place = el("output", { class: "soft" });
  private readonly rate = el("select", { "aria-label": "time units a second" });
  private readonly caption = el("p", { class: "caption soft" });
  private readonly plots = [
    ["order", new Plot(KINDS.order)],
    ["drift", new Plot(KINDS.drift)],
  ] as const;
  private timeline: Timeline | null = null;
  /** Counts the timelines: no positions are interpolated from one to another. */
  private epoch = 0;
  /** The time that is shown. */
  private position = 0;
  private playing = false;
  private shown = -1;
  private taken: Drawn | null = null;
  private ticked = 0;
  private drawing: ReturnType<typeof setTimeout> | undefined;

  constructor(title: string) {
    this.view = new View({
      take: () => {
        const { taken } = this;
        this.taken = null;
        return taken;
      },
      // More frames than are drawn may be played, or the time was set.
      between: (after, { time }) => {
        const first = this.timeline!.at(Math.max(after, time - MAX_TIME)) + 1;
        const count = Math.max(0, this.timeline!.at(time) - first);
        return Array.from({ length: count }, (_, k) => this.drawn(first + k));
      },
      state: () => undefined,
      changed: () => {
        this.toolbar.show();
        const frame = this.timeline?.frames[this.shown];
        if (frame) {
          this.showNumbers(frame);
        }
      },
      directed: () => undefined,
      failed: (error) => {
        throw error;
      },
    });
    const { layers } = this.view;
    layers.headings = true;
    layers.trails = true;
    this.toolbar = new Toolbar(this.view, LAYERS);
    this.view.buttons = this.toolbar.element;
    this.view.canvas.setAttribute("aria-label", title);
    this.rate.append(
      ...RATES.map((it) =>
        el("option", { value: String(it), selected: it === USUAL_RATE }, `× ${it}`),
      ),
    );
    this.rate.title = "time units a second";
    this.slider.addEventListener("input", () => {
      const { start, total } = this.timeline ?? { start: 0, total: 0 };
      this.seek(start + (Number(this.slider.value) / STEPS) * (total - start));
    });
    this.play.setAttribute("aria-keyshortcuts", "Space");
    for (const [, plot] of this.plots) {
      plot.onSeek((it) => this.seek(it));
    }
    this.element = el(
      "div",
      { class: "seen" },
      el(
        "figure",
        { class: "view", "aria-label": `picture of ${title}` },
        this.view.canvas,
        this.toolbar.element,
        this.caption,
      ),
      el("div", { class: "playback" }, this.play, this.slider, this.place, this.rate),
      el(
        "section",
        { class: "chart-section", "aria-label": "charts" },
        el("div", { class: "charts" }, ...this.plots.map(([, plot]) => plot.element)),
      ),
    );
    const observer = new ResizeObserver(() => {
      for (const [, plot] of this.plots) {
        plot.resize();
      }
    });
    observer.observe(this.element);
    onTheme(() => {
      for (const [, plot] of this.plots) {
        plot.redraw();
      }
    });
    this.showPlaying();
  }

  /** Shows another timeline from its beginning. */
  open(timeline: Timeline): void {
    this.timeline = timeline;
    this.epoch += 1;
    this.position = timeline.start;
    this.shown = -1;
    this.playing = false;
    if (!reduced.matches) {
      this.toggle();
    }
    this.showPlaying();
    this.grown();
  }

  /** The timeline has more frames, or its length is known. */
  grown(): void {
    const { timeline } = this;
    if (timeline) {
      this.show();
      this.drawing ??= setTimeout(() => this.drawCharts(), DRAW_INTERVAL_MS);
    }
  }

  toggle(): void {
    const { timeline } = this;
    this.playing = !this.playing;
    if (this.playing && timeline && this.position >= timeline.total && timeline.total > 0) {
      this.seek(timeline.start);
    }
    this.ticked = performance.now();
    this.showPlaying();
    if (this.playing) {
      requestAnimationFrame((now) => this.tick(now));
    }
  }

  /** Handles a key; returns whether it did. */
  key(key: string): boolean {
    if (key === " ") {
      this.toggle();
      return true;
    }
    return this.toolbar.key(key);
  }

  private tick(now: number): void {
    const { timeline } = this;
    if (!this.playing || !timeline) {
      return;
    }
    const passed = Math.max(0, now - this.ticked) / 1000;
    this.ticked = now;
    this.position = Math.min(timeline.end, this.position + passed * Number(this.rate.value));
    this.show();
    if (this.position >= timeline.total && timeline.total > 0) {
      this.playing = false;
      this.showPlaying();
    } else {
      requestAnimationFrame((next) => this.tick(next));
    }
  }

  /** Shows the time `to`, or the last one that is computed. */
  private seek(to: number): void {
    const { start, end } = this.timeline ?? { start: 0, end: 0 };
    this.position = Math.max(start, Math.min(to, end));
    this.show();
  }

  private show(): void {
    const { timeline } = this;
    const index = timeline?.at(this.position) ?? -1;
    const frame = timeline?.frames[index];
    if (!timeline || !frame) {
      return;
    }
    this.showPosition(timeline, frame);
    const isLast = index === timeline.frames.length - 1;
    if (index === this.shown && !(isLast && timeline.fault)) {
      return;
    }
    this.shown = index;
    this.view.setPi1(frame.pi1);
    this.taken = this.drawn(index, isLast && timeline.fault ? "faulted" : "running");
    this.view.requestDraw();
    this.showNumbers(frame);
  }

  /** A frame as it is drawn. */
  private drawn(index: number, phase: Drawn["phase"] = "running"): Drawn {
    const { frames, times } = this.timeline!;
    return { ...frames[index]!, epoch: this.epoch, time: times[index]!, phase, origin: [0, 0] };
  }

  private showNumbers(frame: Shown): void {
    const informed = frame.weight.filter((it) => it > 0).length;
    const parts = [
      plural(frame.id.length, "individual"),
      `${informed} informed${informed > 0 && this.view.layers.headings ? " (outlined)" : ""}`,
      ...(frame.contacts === null ? [] : [plural(frame.contacts, "contact")]),
    ];
    setText(this.caption, parts.join(" · "));
    for (const [name, plot] of this.plots) {
      setText(plot.now, name === "order" ? fixed(frame.order, 3) : signed(frame.drift, 3));
    }
    const numbers = `${parts.join(", ")}, step ${frame.step}, order ${fixed(frame.order, 2)}`;
    // While it plays, a screen reader would not finish one text before the next.
    if (!this.playing) {
      this.view.canvas.setAttribute("aria-label", numbers);
    }
  }

  private showPosition(timeline: Timeline, frame: Shown): void {
    const { start, total, end } = timeline;
    const share = (to: number) => (total > start ? Math.min(1, (to - start) / (total - start)) : 0);
    this.slider.value = String(STEPS * share(this.position));
    const text = `t ${time(frame.step * timeline.dt)} · step ${grouped(frame.step)}`;
    this.slider.setAttribute("aria-valuetext", text);
    setText(this.place, text);
    for (const [, plot] of this.plots) {
      plot.mark(this.position);
    }
    this.slider.style.setProperty("--computed", `${100 * share(end)}%`);
  }

  private showPlaying(): void {
    const frame = this.timeline?.frames[this.shown];
    if (frame) {
      this.showNumbers(frame);
    }
    setText(this.play, this.playing ? "❚❚ Pause" : "▶ Play");
  }

  private drawCharts(): void {
    this.drawing = undefined;
    const { timeline } = this;
    if (!timeline) {
      return;
    }
    for (const [name, plot] of this.plots) {
      plot.setSpan(timeline.total);
      plot.draw(timeline.times, timeline[name]);
      // The group has no drift if no individual is informed, and a recording stores none.
      plot.element.hidden = name === "drift" && timeline.drift.every((it) => it === null);
    }
    for (const [, plot] of this.plots) {
      plot.resize();
      plot.mark(this.position);
    }
  }
}
