/** The picture of a swarm and its subscription; used by the page of a swarm and by the gallery. */

import { View } from "../canvas/view.ts";
import { announceError } from "../ui/announce.ts";
import { button, callAll, el, setText } from "../ui/dom.ts";
import { fixed, plural, rates, time } from "../ui/format.ts";
import type { Session } from "../ui/session.ts";
import { lostText } from "../ui/token_dialog.ts";
import { get } from "../wire/http.ts";
import type { Connection } from "../wire/live.ts";
import type { OrderSample, Parameter, SwarmSummary } from "../wire/messages.ts";
import type { SwarmEvent } from "../wire/page.ts";
import { decodeState, type State } from "../wire/state.ts";
import { Toolbar } from "./toolbar.ts";

/** Verbs that may change parameters. */
const CHANGES = ["set", "batch", "fired", "reset", "run", "inject", "remove"];
/** The layers that are switched by buttons. */
const LAYERS = ["contacts", "clusters", "trails", "preferences"] as const;
const METER_MS = 1000;
/** The minimum time between two descriptions of the picture in the same phase. */
const DESCRIBE_MS = 2000;

export interface WatchEvents {
  state(state: State): void;
  order?(message: OrderSample): void;
  /** The swarm's row in the list; undefined if there is no such swarm. */
  row(row: SwarmSummary | undefined): void;
  parameters?(parameters: Parameter[]): void;
  event?(event: SwarmEvent): void;
  /** The swarm was missing and its name exists again, perhaps as another swarm. */
  replaced?(): void;
  /** Events were skipped, or the connection is new. */
  /** `again` if the connection was lost: the daemon may have restarted. */
  catchUp?(again?: boolean): void;
  changed?(): void;
  directed(direction: number): void;
}

export class Watch {
  readonly element: HTMLElement;
  readonly view: View<State>;
  readonly toolbar: Toolbar;
  parameters: Parameter[] = [];
  /** Whether the swarm is a playback, whose individuals cannot be changed. */
  replay = false;

  private readonly hint = el("span", {});
  private readonly mode = el("p", { class: "hint", role: "status", hidden: true });
  private readonly overlay = el("p", { class: "overlay", role: "status", hidden: true });
  private readonly fault = el("p", { class: "fault", role: "status", hidden: true });
  private readonly meter = el("p", { class: "meter", "data-fps": "0" });
  private readonly jumps = el("span", { class: "jumps", hidden: true });
  private readonly rates = el("span", { class: "rates" });
  private readonly unlisten: (() => void)[];
  private readonly timer: ReturnType<typeof setInterval>;
  private counted = { drawn: 0, states: 0, at: performance.now() };
  private states = 0;
  /** The longest simulated time between two states that were drawn one after the other, and not interpolated. */
  private jumped = 0;
  private missing = false;
  /** The other daemon that claims the name. */
  private rival: string | null = null;
  private absent = 0;
  private described = { at: Number.NEGATIVE_INFINITY, phase: "" };
  private describing: ReturnType<typeof setTimeout> | undefined;
  /** The number of requests for parameters. */
  private reads = 0;
  private connection: Connection = "connecting";
  /** Whether it was open before. */
  private connected = false;

  constructor(
    readonly swarm: string,
    private readonly session: Session,
    private readonly events: WatchEvents,
  ) {
    const { live } = session;
    this.view = new View({
      take: () => {
        const bytes = live.takeState();
        return bytes && decodeState(bytes);
      },
      state: (state) => this.takeState(state),
      changed: () => this.changed(),
      directed: (direction) => events.directed(direction),
      failed: announceError,
    });
    this.view.canvas.setAttribute("aria-label", `${swarm}: no state received`);
    const leave = button("Cancel (Esc)", () => this.enter("look"));
    leave.addEventListener("mousedown", (event) => event.preventDefault());
    this.mode.append(this.hint, " ", leave);
    this.jumps.title =
      "Straight lines between states so far apart would show bodies where they never were, so " +
      "positions are not interpolated. A lower rate shows the motion. If more states come than " +
      "pictures are drawn, only the newest of them is drawn.";
    this.meter.append(this.jumps, this.rates);
    this.toolbar = new Toolbar(this.view, LAYERS, () => this.enter("lasso"));
    this.view.buttons = this.toolbar.element;
    this.element = el(
      "figure",
      { class: "view", "aria-label": `picture of ${swarm}` },
      this.view.canvas,
      this.toolbar.element,
      this.mode,
      this.overlay,
      this.fault,
      this.meter,
    );
    const unlisten = live.listen({
      state: () => {
        this.states += 1;
        this.view.requestDraw();
      },
      order: (message) => events.order?.(message),
      event: (event) => this.takeEvent(event),
      missed: () => events.catchUp?.(),
      gone: () => {
        this.markMissing();
        events.row(undefined);
      },
      swarms: (rows) => {
        const row = rows.find((it) => it.swarm === swarm);
        this.replay = row?.replay ?? this.replay;
        this.setRival(row?.contested_by ?? null);
        // A single list without the swarm may predate its creation.
        this.absent = row ? 0 : this.absent + 1;
        if (row && this.missing) {
          // A new swarm of this name may be paused: only a new connection sends its state.
          live.reconnect();
          this.markPresent();
        }
        if (this.absent > 1) {
          this.markMissing();
        }
        events.row(row);
      },
      connection: (connection) => {
        this.connection = connection;
        this.showAvailability();
        // While the swarm is missing each connection ends at once.
        if (connection === "open" && !this.missing) {
          void this.readParameters();
          events.catchUp?.(this.connected);
          this.connected = true;
        }
      },
    });
    this.unlisten = [unlisten, session.onChange(() => this.showAvailability())];
    live.watch(swarm);
    this.timer = setInterval(() => this.measure(), METER_MS);
  }

  enter(mode: "look" | "lasso" | "direct"): void {
    this.view.mode = this.view.mode === mode ? "look" : mode;
  }

  /** Handles a key; returns whether it did. */
  key(event: KeyboardEvent): boolean {
    if (event.key === "l") {
      this.enter("lasso");
    } else if (event.key === "d") {
      // A lasso enters this mode: the key must not leave it again.
      if (this.view.mode !== "direct") {
        this.enter("direct");
      }
    } else if (event.key === "Escape") {
      const isTyping = (event.target as Element).closest("input, select, textarea");
      if (this.view.mode !== "look") {
        this.enter("look");
      } else if (isTyping) {
        return false;
      } else {
        this.view.change(() => this.view.selected.clear());
      }
    } else {
      return this.toolbar.key(event.key);
    }
    return true;
  }

  async readParameters(): Promise<void> {
    this.reads += 1;
    const { reads } = this;
    try {
      const { result } = await get<{ parameters: Parameter[] }>(this.swarm, "parameters");
      if (reads !== this.reads) {
        // A later request was sent since, whose reply may have overtaken this one.
        return;
      }
      this.parameters = result.parameters;
      const pi1 = result.parameters.find((it) => it.name === "pi1")?.value;
      if (typeof pi1 === "number") {
        this.view.setPi1(pi1);
      }
      this.events.parameters?.(result.parameters);
    } catch {
      // No connection, or no such swarm: the next connection requests them again.
    }
  }

  end(): void {
    clearInterval(this.timer);
    clearTimeout(this.describing);
    callAll(this.unlisten);
    this.view.end();
  }

  private takeState(state: State): void {
    this.markPresent();
    this.showAvailability();
    if (this.view.apart >= this.view.limit) {
      this.jumped = Math.max(this.jumped, this.view.apart);
    }
    this.describe(state);
    this.fault.hidden = state.phase !== "faulted";
    setText(
      this.fault,
      state.phase === "faulted" ? `⚠ Faulted at t = ${time(state.time)}: the last good state` : "",
    );
    this.events.state(state);
  }

  /** Shows or hides the notice that another daemon claims the name. */
  private setRival(rival: string | null): void {
    if (rival === this.rival) {
      return;
    }
    this.rival = rival;
    this.showAvailability();
    if (rival === null) {
      this.session.live.reconnect();
    }
  }

  private markMissing(): void {
    this.missing = true;
    this.view.change(() => this.view.selected.clear());
    this.showAvailability();
  }

  /** The swarm exists. If it was missing, it may be another one of this name. */
  private markPresent(): void {
    if (this.missing) {
      this.missing = false;
      this.showAvailability();
      void this.readParameters();
      this.events.replaced?.();
    }
  }

  private takeEvent(event: SwarmEvent): void {
    const { kind, verb } = event.event;
    if (kind === "deleted") {
      // A state that is not drawn yet belongs to the deleted swarm.
      this.session.live.takeState();
      this.markMissing();
      this.events.row(undefined);
    } else if (kind !== "command" || CHANGES.includes(String(verb))) {
      void this.readParameters();
    }
    this.events.event?.(event);
  }

  /** Describes the picture for screen readers, at most every DESCRIBE_MS in the same phase. */
  private describe(state: State): void {
    const now = performance.now();
    const rest = this.described.at + DESCRIBE_MS - now;
    clearTimeout(this.describing);
    if (rest > 0 && state.phase === this.described.phase) {
      // No later state may come.
      this.describing = setTimeout(() => this.describe(state), rest);
    } else {
      this.described = { at: now, phase: state.phase };
      const informed = state.weight.filter((it) => it > 0).length;
      const parts = [
        `${plural(state.id.length, "individual")}, ${informed} informed, ${state.phase}`,
        `order ${fixed(state.order.order, 2)}`,
      ];
      this.view.canvas.setAttribute("aria-label", `${this.swarm}: ${parts.join(", ")}`);
    }
  }

  private changed(): void {
    this.toolbar.show();
    const { mode, selected } = this.view;
    const count = plural(selected.size, "individual");
    const hints = {
      look: "",
      lasso: "Draw around the individuals to select.",
      direct: this.replay
        ? "Selected. The individuals of a recording cannot be informed."
        : !this.session.mayCommand
          ? `Selected. ${this.session.refusal}.`
          : selected.size === 0
            ? "Click the individuals to inform, then drag the direction."
            : `Drag the direction for ${count}.`,
    };
    setText(this.hint, hints[mode]);
    this.mode.hidden = mode === "look";
    this.element.dataset.mode = mode;
    this.events.changed?.();
  }

  /** Dims the picture while it is not current, and shows why. */
  private showAvailability(): void {
    const lost = this.connection === "lost";
    const missing = this.missing && !lost;
    const contested = this.rival !== null && !lost;
    const unserved = lost || missing || contested;
    this.element.classList.toggle("dimmed", unserved);
    this.overlay.hidden = !unserved && this.view.state !== null;
    const text = contested
      ? `Contested: daemon ${this.rival} also has a swarm ${this.swarm}. This daemon executes no commands on it now.`
      : missing
        ? `No swarm ${this.swarm} on this daemon.`
        : lost
          ? lostText(this.session)
          : "Requesting the state …";
    setText(this.overlay, text);
  }

  private measure(): void {
    const now = performance.now();
    const secs = (now - this.counted.at) / 1000;
    const drawn = (this.view.drawn - this.counted.drawn) / secs;
    const states = (this.states - this.counted.states) / secs;
    this.counted = { drawn: this.view.drawn, states: this.states, at: now };
    this.meter.dataset.fps = drawn.toFixed(1);
    const jumped = this.jumped.toPrecision(2);
    this.jumps.hidden = this.jumped === 0;
    setText(
      this.jumps,
      this.jumped === 0
        ? ""
        : `positions not interpolated: drawn states up to ${Number(jumped)} time units apart`,
    );
    this.jumped = 0;
    setText(this.rates, drawn < 0.5 ? "" : rates(drawn, states));
  }
}
