/** The picture of one swarm: draws the newest state in the next animation frame after a change, and
 * holds the camera, the selection and the pointer mode. */
import { type Body, bodyOf, halfLengthTime } from "../geometry/body.ts";
import { enclosed, nearest } from "../geometry/lasso.ts";
import { preferences } from "../geometry/preference.ts";
import { findClusters, findTouching } from "../geometry/touching.ts";
import { callAll, el } from "../ui/dom.ts";
import { isDark, onTheme } from "../ui/theme.ts";
import type { Drawn } from "../wire/state.ts";
import { clear } from "./bodies.ts";
import { Camera, extentOf } from "./camera.ts";
import { colours } from "./colours.ts";
import { Gestures, type Mode } from "./gestures.ts";
import { Motion } from "./motion.ts";
import { type Layers, type Picture, paint } from "./painting.ts";
import { Trails } from "./trails.ts";

/** More pixels cost time without a GPU and are hardly visible. */
const MAX_PIXEL_RATIO = 2;
/** The distance from a body, in pixels, at which a click still selects it. */
const CLICK_REACH_PX = 8;
/** The space around the buttons, which bodies keep clear of. */
const BUTTONS_MARGIN_PX = 16;

export interface ViewEvents<State extends Drawn> {
  /** The newest state, if there is one that was not taken; throws if it is invalid. */
  take(): State | null;
  /** The states between a time and a taken state, oldest first, through which trails go. */
  between?(after: number, state: State): Drawn[];
  /** A state was taken. */
  state(state: State): void;
  /** The selection, the mode, the camera or the shown layers have changed. */
  changed(): void;
  /** A direction was dragged: radians, counter-clockwise from +x. */
  directed(direction: number): void;
  /** `take` has thrown. */
  failed(error: unknown): void;
}

const reduced = matchMedia("(prefers-reduced-motion: reduce)");

export class View<State extends Drawn = Drawn> {
  readonly canvas: HTMLCanvasElement;
  readonly camera = new Camera();
  readonly layers: Layers = {
    headings: false,
    contacts: false,
    clusters: false,
    trails: false,
    preferences: false,
  };
  /** Ids: indices change when individuals are injected or removed. */
  readonly selected = new Set<number>();
  /** The buttons at the right edge of the picture. */
  buttons: HTMLElement | null = null;
  /** Pictures drawn so far. */
  drawn = 0;
  /** The simulated time between the two newest states. */
  apart = 0;

  private readonly g: CanvasRenderingContext2D;
  private readonly gestures: Gestures;
  private readonly motion = new Motion<State>();
  private readonly trails = new Trails();
  private readonly ends: (() => void)[] = [];
  private body: Body = bodyOf(4);
  private frameRequest = 0;
  private fresh = true;
  private lasso: number[] | null = null;
  private arrow: [[number, number], [number, number]] | null = null;
  private preferenceVectors: { vectors: Float64Array; of: Drawn } | null = null;
  private touching: { pairs: Uint32Array; of: Drawn; with: Body } | null = null;

  constructor(private readonly events: ViewEvents<State>) {
    this.canvas = el("canvas", { class: "picture", tabindex: "0", role: "img" });
    this.g = this.canvas.getContext("2d", { alpha: false })!;
    this.gestures = new Gestures(this.canvas, {
      pan: (right, down) => this.change(() => this.camera.pan(right, down)),
      zoom: (left, top, factor) => this.change(() => this.camera.zoomAt(left, top, factor)),
      click: (left, top, adds) => this.click(left, top, adds),
      lasso: (line, done, adds) => this.drawLasso(line, done, adds),
      direct: (from, to, done) => this.drawArrow(from, to, done),
      cancel: () =>
        this.change(() => {
          this.lasso = null;
          this.arrow = null;
        }),
    });
    const observer = new ResizeObserver(() => this.resize());
    observer.observe(this.canvas);
    this.ends.push(
      () => observer.disconnect(),
      onTheme(() => this.requestDraw()),
    );
  }

  get state(): State | null {
    return this.motion.newest;
  }

  get mode(): Mode {
    return this.gestures.mode;
  }

  set mode(mode: Mode) {
    this.gestures.mode = mode;
    this.canvas.dataset.mode = mode;
    this.gestures.abandon();
    this.change(() => undefined);
  }

  /** Sets the length over width of the bodies. */
  setPi1(pi1: number): void {
    this.body = bodyOf(pi1);
    this.requestDraw();
  }

  /** States this far apart or further, in simulated time, are not interpolated. */
  get limit(): number {
    return halfLengthTime(this.body);
  }

  /** Draws the newest state in the next animation frame. */
  requestDraw(): void {
    if (this.frameRequest === 0) {
      this.frameRequest = requestAnimationFrame((now) => this.draw(now));
    }
  }

  /** Applies a change, draws, and notifies the listener. */
  change(apply: () => void): void {
    apply();
    this.requestDraw();
    this.events.changed();
  }

  pairs(): Uint32Array {
    const { state, body } = this;
    if (!state) {
      return new Uint32Array();
    }
    if (this.touching?.of !== state || this.touching.with !== body) {
      this.touching = { pairs: findTouching(state, body), of: state, with: body };
    }
    return this.touching.pairs;
  }

  /** Forgets what belongs to another swarm of this name: its trails, and the selected individuals. */
  forget(): void {
    this.trails.clear();
    this.change(() => this.selected.clear());
  }

  end(): void {
    cancelAnimationFrame(this.frameRequest);
    callAll(this.ends);
  }

  private draw(now: number): void {
    this.frameRequest = 0;
    try {
      const taken = this.events.take();
      if (taken) {
        this.accept(taken, now);
      }
    } catch (error) {
      this.events.failed(error);
    }
    const { g, state, camera, body } = this;
    const palette = colours(isDark());
    if (!state || camera.width < 2) {
      clear({ g, camera, colours: palette });
      return;
    }
    const bodies = this.motion.at(now);
    const jumps = this.fresh || reduced.matches;
    const zooms = camera.track(extentOf(bodies.x, bodies.y, camera.whole), jumps);
    this.fresh = false;
    const scale = String(camera.scale);
    if (this.canvas.dataset.scale !== scale) {
      // Tests compute from it where bodies are on the screen.
      this.canvas.dataset.scale = scale;
    }
    paint({ g, camera, bodies, body, colours: palette }, this.compose(state));
    this.drawn += 1;
    if (zooms || this.motion.isMoving()) {
      this.requestDraw();
    }
  }

  private accept(state: State, now: number): void {
    const before = this.state;
    const [dx, dy] = this.motion.accept(state, now, document.hidden, this.limit);
    this.apart = before?.epoch === state.epoch ? state.time - before.time : 0;
    if (dx !== 0 || dy !== 0) {
      this.camera.rebase(dx, dy);
      this.trails.rebase(dx, dy);
    }
    if (
      !before ||
      before.epoch !== state.epoch ||
      before.id.length !== state.id.length ||
      // In a playback that was set back, what was drawn is not the past of this state.
      state.time < before.time
    ) {
      this.trails.clear();
    }
    for (const it of this.events.between?.(this.trails.time, state) ?? []) {
      this.trails.keep(it);
    }
    this.trails.keep(state);
    if (this.selected.size > 0) {
      const present = new Set(state.id);
      for (const id of this.selected) {
        if (!present.has(id)) {
          this.selected.delete(id);
        }
      }
      this.events.changed();
    }
    this.events.state(state);
  }

  private compose(state: Drawn): Picture {
    const { layers } = this;
    const pairs = layers.contacts || layers.clusters ? this.pairs() : new Uint32Array();
    const selected: number[] = [];
    state.id.forEach((id, i) => {
      if (this.selected.has(id)) {
        selected.push(i);
      }
    });
    return {
      state,
      layers,
      trails: this.trails,
      pairs,
      clusters: layers.clusters ? findClusters(state.id.length, pairs) : [],
      preferences: layers.preferences ? this.preferences(state) : null,
      selected,
      lasso: this.lasso,
      arrow: this.arrow,
    };
  }

  /** Quadratic in n, so computed once per state. */
  private preferences(state: Drawn): Float64Array {
    if (this.preferenceVectors?.of !== state) {
      this.preferenceVectors = {
        vectors: preferences(state, state.weight, state.direction),
        of: state,
      };
    }
    return this.preferenceVectors.vectors;
  }

  private resize(): void {
    const { canvas, camera } = this;
    const ratio = Math.min(MAX_PIXEL_RATIO, devicePixelRatio);
    camera.width = canvas.clientWidth;
    camera.height = canvas.clientHeight;
    camera.buttons = (this.buttons?.offsetWidth ?? 0) + BUTTONS_MARGIN_PX;
    canvas.width = Math.max(1, Math.round(camera.width * ratio));
    canvas.height = Math.max(1, Math.round(camera.height * ratio));
    this.g.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.fresh = true;
    cancelAnimationFrame(this.frameRequest);
    // Resizing clears the canvas: drawing now avoids an empty frame.
    this.draw(performance.now());
  }

  private click(left: number, top: number, adds: boolean): void {
    const { state } = this;
    if (!state) {
      return;
    }
    const [x, y] = this.camera.toPlane(left, top);
    const bodies = this.motion.at(performance.now());
    const met = nearest(bodies, this.body, x, y, CLICK_REACH_PX / this.camera.scale);
    this.change(() => {
      if (met === null) {
        if (!adds) {
          this.selected.clear();
        }
        return;
      }
      const id = state.id[met]!;
      if (!this.selected.delete(id)) {
        this.selected.add(id);
      }
    });
  }

  private drawLasso(line: number[], done: boolean, adds: boolean): void {
    const { state } = this;
    this.lasso = done ? null : line;
    if (done && state) {
      const polygon: number[] = [];
      for (let k = 0; k < line.length; k += 2) {
        polygon.push(...this.camera.toPlane(line[k]!, line[k + 1]!));
      }
      if (!adds) {
        this.selected.clear();
      }
      for (const i of enclosed(polygon, this.motion.at(performance.now()))) {
        this.selected.add(state.id[i]!);
      }
      this.mode = this.selected.size > 0 ? "direct" : "look";
      return;
    }
    this.requestDraw();
  }

  private drawArrow(from: [number, number], to: [number, number], done: boolean): void {
    this.arrow = done ? null : [from, to];
    this.requestDraw();
    if (done) {
      // One drag sends one command; the next drag pans. The screen's y axis points down.
      this.mode = "look";
      this.events.directed(Math.atan2(from[1] - to[1], to[0] - from[0]));
    }
  }
}
