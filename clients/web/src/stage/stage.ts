/**
 * The picture of one swarm: takes states, draws when something has changed and the browser is
 * ready for it, and tells whom somebody has selected.
 */
import { type Body, bodyOf, halfLengthTime } from "../geometry/body.ts";
import { enclosed, nearest } from "../geometry/lasso.ts";
import { preferences } from "../geometry/preference.ts";
import { type Bodies, findClusters, findTouching } from "../geometry/touching.ts";
import { el } from "../parts/dom.ts";
import { isDark, onTheme } from "../parts/theme.ts";
import { decodeState, type State } from "../wire/state.ts";
import { Camera, extentOf } from "./camera.ts";
import { colours } from "./colours.ts";
import { Gestures, type Mode } from "./gestures.ts";
import { Motion } from "./motion.ts";
import { type Picture, paint, type Shows } from "./painting.ts";
import { Trails } from "./trails.ts";

/** Enough for a screen of today; more costs time without a GPU. */
const MOST_PIXEL_RATIO = 2;
/** How far from a body a click still means it, in pixels. */
const CLICK_REACH_PX = 8;

export interface StageEvents {
  /** The newest undecoded state, if there is one. */
  take(): ArrayBuffer | null;
  /** A state came in. */
  state(state: State): void;
  /** Somebody else is selected, or the mode, the camera or what is shown has changed. */
  changed(): void;
  /** A direction was dragged: radians, counter-clockwise from +x. */
  directed(direction: number): void;
  /** A state was no state. */
  failed(error: unknown): void;
}

const reduced = matchMedia("(prefers-reduced-motion: reduce)");

export class Stage {
  readonly canvas: HTMLCanvasElement;
  readonly camera = new Camera();
  readonly shows: Shows = { contacts: false, clusters: false, trails: false, preferences: false };
  /** Ids, which outlast a change of the group. */
  readonly selected = new Set<number>();
  /** Pictures drawn so far. */
  drawn = 0;
  /** The swarm's time between the two newest states. */
  apart = 0;

  private readonly g: CanvasRenderingContext2D;
  private readonly gestures: Gestures;
  private readonly motion = new Motion();
  private readonly trails = new Trails();
  private readonly ends: (() => void)[] = [];
  private body: Body = bodyOf(4);
  private asked = 0;
  private fresh = true;
  private lasso: number[] | null = null;
  private arrow: [[number, number], [number, number]] | null = null;
  private wished: { vectors: Float64Array; of: State } | null = null;
  private found: { pairs: Uint32Array; of: State; with: Body } | null = null;

  constructor(private readonly events: StageEvents) {
    this.canvas = el("canvas", { class: "picture", tabindex: "0", role: "img" });
    this.g = this.canvas.getContext("2d", { alpha: false })!;
    this.gestures = new Gestures(this.canvas, {
      pan: (right, down) => this.change(() => this.camera.pan(right, down)),
      zoom: (left, top, factor) => this.change(() => this.camera.zoomAt(left, top, factor)),
      click: (left, top, adds) => this.click(left, top, adds),
      lasso: (line, done, adds) => this.drawLasso(line, done, adds),
      direct: (from, to, done) => this.drawArrow(from, to, done),
      cancel: () => this.change(() => this.dropDrafts()),
    });
    const observer = new ResizeObserver(() => this.resize());
    observer.observe(this.canvas);
    this.ends.push(
      () => observer.disconnect(),
      onTheme(() => this.ask()),
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

  /** The bodies' length over width. */
  setPi1(pi1: number): void {
    this.body = bodyOf(pi1);
    this.ask();
  }

  /** The time between two states from which on no motion is drawn between them. */
  get limit(): number {
    return halfLengthTime(this.body);
  }

  /** Draws when the browser is ready, the newest state if one has come. */
  ask(): void {
    if (this.asked === 0) {
      this.asked = requestAnimationFrame((now) => this.draw(now));
    }
  }

  /** Applies a change of what is seen, draws, and tells. */
  change(apply: () => void): void {
    apply();
    this.ask();
    this.events.changed();
  }

  pairs(): Uint32Array {
    const { state, body } = this;
    if (!state) {
      return new Uint32Array();
    }
    if (this.found?.of !== state || this.found.with !== body) {
      this.found = { pairs: findTouching(state, body), of: state, with: body };
    }
    return this.found.pairs;
  }

  end(): void {
    cancelAnimationFrame(this.asked);
    for (const end of this.ends) {
      end();
    }
  }

  private draw(now: number): void {
    this.asked = 0;
    const bytes = this.events.take();
    if (bytes) {
      try {
        this.accept(decodeState(bytes), now);
      } catch (error) {
        this.events.failed(error);
      }
    }
    const { state, camera } = this;
    if (!state || camera.width < 2) {
      this.g.fillStyle = colours(isDark()).paper;
      this.g.fillRect(0, 0, camera.width, camera.height);
      return;
    }
    const bodies = this.motion.at(now);
    const jumps = this.fresh || reduced.matches;
    const zooms = camera.track(extentOf(bodies.x, bodies.y, camera.whole), jumps);
    this.fresh = false;
    this.tellScale();
    paint(this.g, camera, colours(isDark()), this.compose(state, bodies));
    this.drawn += 1;
    if (zooms || this.motion.isMoving()) {
      this.ask();
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
    if (!before || before.epoch !== state.epoch || before.id.length !== state.id.length) {
      this.trails.clear();
    }
    this.trails.keep(state);
    if (this.selected.size > 0) {
      const there = new Set(state.id);
      for (const id of this.selected) {
        if (!there.has(id)) {
          this.selected.delete(id);
        }
      }
    }
    this.events.state(state);
  }

  private compose(state: State, bodies: Bodies): Picture {
    const { shows } = this;
    const pairs = shows.contacts || shows.clusters ? this.pairs() : new Uint32Array();
    const selected: number[] = [];
    state.id.forEach((id, i) => {
      if (this.selected.has(id)) {
        selected.push(i);
      }
    });
    return {
      state,
      bodies,
      body: this.body,
      shows,
      trails: this.trails,
      pairs,
      clusters: shows.clusters ? findClusters(state.id.length, pairs) : [],
      preferences: shows.preferences ? this.preferences(state) : null,
      selected,
      lasso: this.lasso,
      arrow: this.arrow,
    };
  }

  /** For whoever has to find bodies on the screen, as tests do. */
  private tellScale(): void {
    const scale = String(this.camera.scale);
    if (this.canvas.dataset.scale !== scale) {
      this.canvas.dataset.scale = scale;
    }
  }

  /** They take a while for many, so once a state. */
  private preferences(state: State): Float64Array {
    if (this.wished?.of !== state) {
      this.wished = { vectors: preferences(state, state.weight, state.direction), of: state };
    }
    return this.wished.vectors;
  }

  private resize(): void {
    const { canvas, camera } = this;
    const ratio = Math.min(MOST_PIXEL_RATIO, devicePixelRatio);
    camera.width = canvas.clientWidth;
    camera.height = canvas.clientHeight;
    canvas.width = Math.max(1, Math.round(camera.width * ratio));
    canvas.height = Math.max(1, Math.round(camera.height * ratio));
    this.g.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.fresh = true;
    cancelAnimationFrame(this.asked);
    // A canvas of another size is empty: it is drawn before it is shown.
    this.draw(performance.now());
  }

  private dropDrafts(): void {
    this.lasso = null;
    this.arrow = null;
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
    this.ask();
  }

  private drawArrow(from: [number, number], to: [number, number], done: boolean): void {
    this.arrow = done ? null : [from, to];
    this.ask();
    if (done) {
      // One drag is one command: the next one pans again. Downwards on the screen is -y.
      this.mode = "look";
      this.events.directed(Math.atan2(from[1] - to[1], to[0] - from[0]));
    }
  }
}
