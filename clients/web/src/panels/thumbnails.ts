/**
 * Requests and draws the thumbnails of cards, over HTTP and only for those in the viewport.
 *
 * A running swarm gets at most two pictures a second, a paused or faulted one a picture per change.
 */
import { drawThumbnail } from "../canvas/thumbnail.ts";
import { callAll } from "../ui/dom.ts";
import { onTheme } from "../ui/theme.ts";
import { currentState, get } from "../wire/http.ts";
import type { Live } from "../wire/live.ts";
import type { SwarmSummary } from "../wire/messages.ts";
import type { State } from "../wire/state.ts";

/** Larger swarms have no thumbnail: their states are long, and their bodies too small to see. */
export const MAX_THUMBNAIL_N = 200;
/** The minimum time between two pictures of a swarm. */
const SWARM_INTERVAL_MS = 500;
/** The minimum time between two requests, of all swarms. Without a GPU a picture costs about 10 ms of
 * CPU time in the browser, so ten pictures a second take a tenth of a core. */
const REQUEST_INTERVAL_MS = 100;
/** Pictures that are requested at a time, each with up to two of the six connections that a browser
 * opens to a host: commands need the others. */
const MAX_PENDING = 2;
/** A failed request is repeated after this time. */
const RETRY_MS = 5000;
/** The shape of the bodies of a running swarm is requested again after this time. */
const SHAPE_INTERVAL_MS = 10_000;

interface Thumbnail {
  readonly swarm: string;
  readonly canvas: HTMLCanvasElement;
  row: SwarmSummary | null;
  visible: boolean;
  /** The state on the canvas. */
  state: State | null;
  /** What `versionOf` returned for the row when the state was requested. */
  version: string;
  pi1: number;
  shapeAt: number;
  /** When the next request is permitted. */
  nextAt: number;
  requested: boolean;
}

/** Changes whenever the picture of a swarm that does not run changes. */
function versionOf({ step, time, n, informed, order }: SwarmSummary): string {
  return [step, time, n, informed, order].join(" ");
}

export class Thumbnails {
  private readonly all = new Map<Element, Thumbnail>();
  private readonly observer: IntersectionObserver;
  private readonly sizes: ResizeObserver;
  private readonly ends: (() => void)[];
  private timer: ReturnType<typeof setTimeout> | undefined;
  private pending = 0;
  private lastRequest = Number.NEGATIVE_INFINITY;
  private enabled = false;

  /** `seen` is called when a card enters or leaves the viewport. */
  constructor(seen: (card: Element, visible: boolean) => void = () => undefined) {
    this.observer = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const thumbnail = this.all.get(target);
        if (thumbnail) {
          thumbnail.visible = isIntersecting;
          seen(target, isIntersecting);
        }
      }
      this.schedule();
    });
    // Resizing a canvas requires a redraw.
    this.sizes = new ResizeObserver((entries) => {
      for (const { target } of entries) {
        const card = target.closest(".card");
        const thumbnail = card && this.all.get(card);
        if (thumbnail) {
          this.draw(thumbnail);
        }
      }
    });
    const resume = () => this.schedule();
    document.addEventListener("visibilitychange", resume);
    this.ends = [
      () => this.observer.disconnect(),
      () => this.sizes.disconnect(),
      () => document.removeEventListener("visibilitychange", resume),
      onTheme(() => {
        for (const it of this.all.values()) {
          this.draw(it);
        }
      }),
    ];
  }

  /**
   * Requests pictures while there is a connection, and dims `page` while there is none. The first list
   * is a cached one, and may contain deleted swarms: no states are requested for it.
   */
  follow(live: Live, page: Element, show: (rows: SwarmSummary[]) => void): void {
    let isCurrent = false;
    this.ends.push(
      live.listen({
        swarms: (rows) => {
          show(rows);
          this.enable(isCurrent);
        },
        connection: (connection) => {
          page.classList.toggle("dimmed", connection === "lost");
          if (connection === "lost") {
            this.enable(false);
          }
        },
      }),
    );
    isCurrent = true;
  }

  add(card: Element, swarm: string, canvas: HTMLCanvasElement): void {
    this.all.set(card, {
      swarm,
      canvas,
      row: null,
      visible: false,
      state: null,
      version: "",
      pi1: 4,
      shapeAt: Number.NEGATIVE_INFINITY,
      nextAt: Number.NEGATIVE_INFINITY,
      requested: false,
    });
    this.observer.observe(card);
    this.sizes.observe(canvas);
  }

  remove(card: Element): void {
    this.observer.unobserve(card);
    const thumbnail = this.all.get(card);
    if (thumbnail) {
      this.sizes.unobserve(thumbnail.canvas);
    }
    this.all.delete(card);
  }

  /** Sets the row of a card's swarm; null if there is no such swarm. */
  show(card: Element, row: SwarmSummary | null): void {
    const thumbnail = this.all.get(card);
    if (thumbnail) {
      thumbnail.row = row;
      if (!row) {
        thumbnail.state = null;
        thumbnail.version = "";
      }
    }
  }

  /** Starts or stops requests. */
  private enable(enabled: boolean): void {
    this.enabled = enabled;
    this.schedule();
  }

  end(): void {
    this.enabled = false;
    clearTimeout(this.timer);
    callAll(this.ends);
    this.all.clear();
  }

  /** Starts the next request as soon as one is due and the limits permit it. */
  private schedule(): void {
    clearTimeout(this.timer);
    if (!this.enabled || document.hidden || this.pending >= MAX_PENDING) {
      return;
    }
    let next: Thumbnail | null = null;
    for (const it of this.all.values()) {
      if (isStale(it) && (next === null || it.nextAt < next.nextAt)) {
        next = it;
      }
    }
    if (next === null) {
      return;
    }
    const now = performance.now();
    // The first picture of a card is not delayed.
    const pause = next.state === null ? 0 : REQUEST_INTERVAL_MS;
    const at = Math.max(next.nextAt, this.lastRequest + pause);
    if (at > now) {
      this.timer = setTimeout(() => this.schedule(), at - now);
      return;
    }
    void this.request(next, now);
    this.schedule();
  }

  private async request(it: Thumbnail, now: number): Promise<void> {
    this.pending += 1;
    this.lastRequest = now;
    it.requested = true;
    it.nextAt = now + SWARM_INTERVAL_MS;
    const version = it.row ? versionOf(it.row) : "";
    try {
      const isShapeStale = now - it.shapeAt >= SHAPE_INTERVAL_MS;
      const [state, pi1] = await Promise.all([
        currentState(it.swarm),
        isShapeStale ? shapeOf(it.swarm) : it.pi1,
      ]);
      it.state = state;
      it.pi1 = pi1;
      it.shapeAt = isShapeStale ? now : it.shapeAt;
      it.version = version;
      this.draw(it);
    } catch {
      // The swarm was deleted, or there is no connection: the list shows it.
      it.nextAt = now + RETRY_MS;
    } finally {
      it.requested = false;
      this.pending -= 1;
      this.schedule();
    }
  }

  private draw({ canvas, state, pi1 }: Thumbnail): void {
    if (state && canvas.isConnected) {
      drawThumbnail(canvas, state, pi1);
      canvas.dataset.step = String(state.step);
    }
  }
}

/** The length over width of a swarm's bodies, which states do not contain. */
async function shapeOf(swarm: string): Promise<number> {
  const { result } = await get<{ parameters: { pi1: number } }>(swarm, "status");
  return result.parameters.pi1;
}

/** Whether a visible card needs a new picture. */
function isStale({ row, visible, requested, version }: Thumbnail): boolean {
  if (!row || !visible || requested || row.n > MAX_THUMBNAIL_N) {
    return false;
  }
  return row.phase === "running" || versionOf(row) !== version;
}
