/**
 * A swarm on the screen: its picture, its numbers, and what keeps both up to date. The page of a
 * swarm and the gallery build on it.
 */
import { complain } from "../parts/announce.ts";
import { el, say } from "../parts/dom.ts";
import { fixed, plural, rates } from "../parts/format.ts";
import type { Session } from "../parts/session.ts";
import { Stage } from "../stage/stage.ts";
import { get } from "../wire/http.ts";
import type { Connection } from "../wire/live.ts";
import type { OrderMessage, Parameter, SwarmEvent, SwarmRow } from "../wire/messages.ts";
import type { State } from "../wire/state.ts";
import { Toolbar } from "./toolbar.ts";

/** Verbs after which the parameters may be others. */
const CHANGES = ["set", "batch", "reset", "run", "inject", "remove"];
const METER_MS = 1000;

export interface WatchEvents {
  state(state: State): void;
  order(message: OrderMessage): void;
  /** What the list says of it; nothing when it is not there. */
  row(row: SwarmRow | undefined): void;
  parameters(parameters: Parameter[]): void;
  event(event: SwarmEvent): void;
  /** It was gone, and there is one of its name: perhaps another one. */
  another(): void;
  /** Events were lost, or the connection is new: there is something to catch up. */
  catchUp(): void;
  changed(): void;
  directed(direction: number): void;
}

export class Watch {
  readonly element: HTMLElement;
  readonly stage: Stage;
  readonly toolbar: Toolbar;
  parameters: Parameter[] = [];
  /** Whether it is a recording, which nobody can change. */
  replay = false;

  private readonly hint = el("span", {});
  private readonly mode = el("p", { class: "hint", role: "status", hidden: true });
  private readonly curtain = el("p", { class: "curtain", role: "status", hidden: true });
  private readonly meter = el("p", { class: "meter", "data-fps": "0" });
  private readonly jumps = el("span", { class: "jumps", hidden: true });
  private readonly rates = el("span", { class: "rates" });
  private readonly unlisten: () => void;
  private readonly timer: ReturnType<typeof setInterval>;
  private counted = { drawn: 0, states: 0, at: performance.now() };
  private states = 0;
  /** The most time between two states that were shown without motion between them. */
  private jumped = 0;
  private gone = false;
  /** The other daemon that holds the name. */
  private rival: string | null = null;
  private absent = 0;
  private described = 0;
  private connection: Connection = "connecting";

  constructor(
    readonly swarm: string,
    private readonly session: Session,
    private readonly events: WatchEvents,
  ) {
    const { live } = session;
    this.stage = new Stage({
      take: () => live.takeState(),
      state: (state) => this.takeState(state),
      changed: () => this.changed(),
      directed: (direction) => events.directed(direction),
      failed: complain,
    });
    const leave = el("button", { type: "button" }, "Cancel (Esc)");
    leave.addEventListener("mousedown", (event) => event.preventDefault());
    leave.addEventListener("click", () => this.enter("look"));
    this.mode.append(this.hint, " ", leave);
    this.jumps.title =
      "Between states so far apart bodies would be drawn where they never were: " +
      "each state is drawn as it is. A lower rate shows the motion.";
    this.meter.append(this.jumps, this.rates);
    this.toolbar = new Toolbar(this.stage, () => this.enter("lasso"));
    this.element = el(
      "figure",
      { class: "stage", "aria-label": `picture of ${swarm}` },
      this.stage.canvas,
      this.toolbar.element,
      this.mode,
      this.curtain,
      this.meter,
    );
    this.unlisten = live.listen({
      state: () => {
        this.states += 1;
        this.stage.ask();
      },
      order: (message) => events.order(message),
      event: (event) => this.takeEvent(event),
      missed: () => events.catchUp(),
      gone: () => {
        this.miss();
        events.row(undefined);
      },
      swarms: (rows) => {
        const row = rows.find((it) => it.swarm === swarm);
        this.replay = row?.replay ?? this.replay;
        this.contest(row?.contested_by ?? null);
        // One list without it may be older than the swarm.
        this.absent = row ? 0 : this.absent + 1;
        if (row && this.gone) {
          // Another one of this name, which may stand still: its state is asked for.
          live.look();
          this.find();
        }
        if (this.absent > 1) {
          this.miss();
        }
        events.row(row);
      },
      connection: (connection) => {
        this.connection = connection;
        this.veil();
        if (connection === "here") {
          void this.readParameters();
          events.catchUp();
        }
      },
    });
    live.watch(swarm);
    if (live.connection === "here") {
      void this.readParameters();
    }
    this.timer = setInterval(() => this.measure(), METER_MS);
    this.veil();
  }

  enter(mode: "look" | "lasso" | "direct"): void {
    this.stage.mode = this.stage.mode === mode ? "look" : mode;
  }

  /** What a key means for the picture; whether it means anything. */
  key(event: KeyboardEvent): boolean {
    if (event.key === "l") {
      this.enter("lasso");
    } else if (event.key === "d") {
      // A lasso leads there by itself: whoever presses it then means the same.
      if (this.stage.mode !== "direct") {
        this.enter("direct");
      }
    } else if (event.key === "Escape") {
      const isTyping = (event.target as Element).closest("input, select, textarea");
      if (this.stage.mode !== "look") {
        this.enter("look");
      } else if (isTyping) {
        return false;
      } else {
        this.stage.change(() => this.stage.selected.clear());
      }
    } else {
      return this.toolbar.key(event.key);
    }
    return true;
  }

  async readParameters(): Promise<void> {
    try {
      const { result } = await get<{ parameters: Parameter[] }>(this.swarm, "parameters");
      this.parameters = result.parameters;
      const pi1 = result.parameters.find((it) => it.name === "pi1")?.value;
      if (typeof pi1 === "number") {
        this.stage.setPi1(pi1);
      }
      this.events.parameters(result.parameters);
    } catch {
      // The daemon is away, or the swarm gone: it is asked again when they are back.
    }
  }

  end(): void {
    clearInterval(this.timer);
    this.unlisten();
    this.stage.end();
  }

  private takeState(state: State): void {
    this.find();
    this.veil();
    if (this.stage.apart >= this.stage.limit) {
      this.jumped = Math.max(this.jumped, this.stage.apart);
    }
    this.describe(state);
    this.events.state(state);
  }

  /** Shows or hides the notice that another daemon holds the name. */
  private contest(rival: string | null): void {
    if (rival === this.rival) {
      return;
    }
    this.rival = rival;
    this.veil();
    if (rival === null) {
      this.session.live.look();
    }
  }

  private miss(): void {
    this.gone = true;
    this.veil();
  }

  /** It is there; if it was gone, somebody made one of this name: what is known of the last is of
   * no use. */
  private find(): void {
    if (this.gone) {
      this.gone = false;
      this.veil();
      void this.readParameters();
      this.events.another();
    }
  }

  private takeEvent(event: SwarmEvent): void {
    const { kind, verb } = event.event;
    if (kind === "deleted") {
      // Discard the state that is not drawn yet: it is of the deleted swarm.
      this.session.live.takeState();
      this.miss();
      this.events.row(undefined);
    } else if (kind !== "command" || CHANGES.includes(String(verb))) {
      void this.readParameters();
    }
    this.events.event(event);
  }

  /** Says for those who do not see it what the picture shows, now and then. */
  private describe(state: State): void {
    const now = performance.now();
    if (now - this.described > 2000) {
      this.described = now;
      const informed = state.weight.filter((it) => it > 0).length;
      const said = [
        `${plural(state.id.length, "individual")}, ${informed} informed, ${state.phase}`,
        `order ${fixed(state.order.order, 2)}`,
      ];
      this.stage.canvas.setAttribute("aria-label", `${this.swarm}: ${said.join(", ")}`);
    }
  }

  private changed(): void {
    this.toolbar.show();
    const { mode, selected } = this.stage;
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
            : `Drag the direction that ${count} ${selected.size === 1 ? "is" : "are"} to prefer: one drag, one command.`,
    };
    say(this.hint, hints[mode]);
    this.mode.hidden = mode === "look";
    this.element.dataset.mode = mode;
    this.events.changed();
  }

  /** Dims the last picture while it is not the present one. */
  private veil(): void {
    const away = this.connection === "away";
    const missing = this.gone && !away;
    const contested = this.rival !== null && !away;
    const unserved = away || missing || contested;
    this.element.classList.toggle("dimmed", unserved);
    this.curtain.hidden = !unserved && this.stage.state !== null;
    const words = contested
      ? `Contested: daemon ${this.rival} has a swarm ${this.swarm}, too. This daemon executes no command on it now.`
      : missing
        ? `There is no swarm ${this.swarm} now.`
        : away
          ? "The daemon is away, trying again …"
          : "Asking the daemon …";
    say(this.curtain, words);
  }

  private measure(): void {
    const now = performance.now();
    const secs = (now - this.counted.at) / 1000;
    const drawn = (this.stage.drawn - this.counted.drawn) / secs;
    const states = (this.states - this.counted.states) / secs;
    this.counted = { drawn: this.stage.drawn, states: this.states, at: now };
    this.meter.dataset.fps = drawn.toFixed(1);
    const jumped = this.jumped.toPrecision(2);
    this.jumps.hidden = this.jumped === 0;
    say(
      this.jumps,
      this.jumped === 0 ? "" : `no motion drawn between states: ${Number(jumped)} time units apart`,
    );
    this.jumped = 0;
    say(this.rates, drawn < 0.5 ? "" : rates(drawn, states));
  }
}
