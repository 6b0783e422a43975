/** The event log. Events that the WebSocket skipped are requested over HTTP. */
import { el } from "../ui/dom.ts";
import { angle, short, time, when } from "../ui/format.ts";
import { get } from "../wire/http.ts";
import type { EventsPage, SwarmEvent } from "../wire/page.ts";

/** Lines that are kept. */
const MAX_LINES = 300;
/** Events per request. The daemon keeps about a thousand, with a gap in their numbers at each restart. */
const MAX_EVENTS = 256;

/** Arguments that are angles. */
const ANGLES = ["direction", "along"];

/** An event as text; angles in degrees. */
export function describe({ event, phase }: SwarmEvent): string {
  const field = (name: string) =>
    event[name] === null || event[name] === undefined ? "" : String(event[name]);
  const by = field("client") === "" ? "" : ` · by ${field("client")}`;
  switch (event.kind) {
    case "command":
      if (event.verb === "annotate") {
        return `note: ${String((event.args as { text?: unknown } | null)?.text)}${by}`;
      }
      if (event.verb === "protect") {
        const { on } = (event.args ?? {}) as { on?: unknown };
        return `${on === true ? "protected from delete and reset" : "no longer protected"}${by}`;
      }
      return `${field("verb")} ${args(event.args)}${by}`;
    case "created":
      return ["", "create"].includes(field("verb"))
        ? `created${by}`
        : `created (${field("verb")})${by}`;
    case "deleted":
      return `deleted${by}`;
    case "phase":
      return field("reason") === "" ? phase : `${phase}: ${field("reason")}`;
    case "model":
      return `model version ${field("to")} goes on, after version ${field("from")}`;
    case "fault":
      return `fault: ${field("reason")}`;
    case "scheduled":
      return `${field("verb")} ${args(event.args)} scheduled for step ${field("applies_at_step")}${by}`;
    case "refused": {
      const error = event.error as { message?: string } | undefined;
      return `${field("verb")} rejected: ${error?.message ?? ""}${by}`;
    }
    case "lapsed":
      return `inform expired, uninformed: ${brief(event.ids)}`;
    default: {
      const { kind, ...rest } = event;
      return `${kind} ${args(rest)}`;
    }
  }
}

function brief(value: unknown): string {
  if (Array.isArray(value)) {
    const all = value.map((it) => (typeof it === "object" ? JSON.stringify(it) : short(it)));
    return all.length > 12 ? `${all.slice(0, 12).join(", ")} … (${all.length})` : all.join(", ");
  }
  if (value !== null && typeof value === "object") {
    return args(value);
  }
  return short(value);
}

function args(value: unknown): string {
  const entries = Object.entries((value ?? {}) as Record<string, unknown>);
  return entries
    .map(([name, it]) =>
      ANGLES.includes(name) && typeof it === "number"
        ? `${name} ${angle(it)}`
        : `${name} ${brief(it)}`,
    )
    .join(", ");
}

export class Events {
  readonly element = el("ol", {
    class: "events",
    tabindex: "0",
    "aria-label": "events, newest first",
  });
  private last = 0;
  private reading = false;
  private repeat = false;
  private ended = false;
  /** Whether the daemon may have forgotten events that are shown, as it does when it restarts. */
  private stale = false;

  /** The wall clock of the last event, by which it is known again. */
  private lastAt: number | null = null;

  /** `replaced` is called if the events are those of another swarm of this name. */
  constructor(
    private readonly swarm: string,
    private readonly replaced: () => void,
  ) {}

  /** Requests the newest events, or those after the last one shown; `again` requests all, so that the
   * list is that of a page opened now. */
  async catchUp(again = false): Promise<void> {
    if (this.ended) {
      return;
    }
    this.stale ||= again;
    if (this.reading) {
      this.repeat = true;
      return;
    }
    this.reading = true;
    try {
      do {
        this.repeat = false;
        await this.read();
      } while (this.repeat && !this.ended);
    } catch {
      // No connection, or no such swarm: the next connection requests them again.
    } finally {
      this.reading = false;
    }
  }

  /** Shows an event from the WebSocket. Requests missing earlier events first, except for the
   * last event: the events of a deleted swarm cannot be requested. */
  take(event: SwarmEvent): void {
    if (event.event.kind === "deleted") {
      this.end();
      this.add(event);
    } else if (this.reading || event.number > this.last + 1) {
      void this.catchUp();
    } else {
      this.add(event);
    }
  }

  /** Stops requesting events. */
  end(): void {
    this.ended = true;
  }

  /** Asks whether the swarm of this name is still the one whose events are shown. */
  async isSame(): Promise<boolean> {
    return (await this.request()) !== null;
  }

  /** The events from the last one that is shown; null if they are those of another swarm. */
  private async request(): Promise<EventsPage | null> {
    // With the last one: the event of its number may be one of another swarm.
    const { last, lastAt } = this;
    const result = await this.after(Math.max(0, last - 1));
    if (this.ended) {
      return null;
    }
    const again = result.events.find((it) => it.number === last)?.unix_secs ?? null;
    if (result.newest < last || (again !== null && lastAt !== null && again !== lastAt)) {
      this.end();
      this.replaced();
      return null;
    }
    return result;
  }

  private async after(number: number): Promise<EventsPage> {
    const noun = `events?after=${number}&limit=${MAX_EVENTS}`;
    return (await get<EventsPage>(this.swarm, noun)).result;
  }

  /** Replaces the events by those that the daemon has. */
  private async readAgain(): Promise<void> {
    // If a connection is lost meanwhile, the next one asks for it again.
    this.stale = false;
    const all: SwarmEvent[] = [];
    for (let at = 0, newest = 1; at < newest; ) {
      const result = await this.after(at);
      all.push(...result.events);
      newest = result.newest;
      at = result.events.at(-1)?.number ?? newest;
    }
    if (this.ended) {
      return;
    }
    this.element.replaceChildren();
    this.last = 0;
    for (const event of all) {
      this.add(event);
    }
  }

  private async read(): Promise<void> {
    if (this.stale) {
      if (await this.request()) {
        await this.readAgain();
      }
      return;
    }
    for (;;) {
      const { last } = this;
      const result = await this.request();
      if (!result) {
        return;
      }
      const { events, newest } = result;
      for (const event of events) {
        this.add(event);
      }
      const read = events.at(-1)?.number ?? newest;
      this.last = Math.max(this.last, read);
      if (read >= newest || read <= last) {
        return;
      }
    }
  }

  private add(event: SwarmEvent): void {
    if (event.number <= this.last) {
      return;
    }
    this.last = event.number;
    this.lastAt = event.unix_secs ?? null;
    const clock = when(event.unix_secs);
    const line = el(
      "li",
      { "data-kind": event.event.kind, "data-number": String(event.number) },
      el("span", { class: "number" }, `#${event.number}`),
      el(
        "span",
        { class: "when", title: `step ${event.step}, epoch ${event.epoch}` },
        `t ${time(event.time)}`,
      ),
      el("span", { class: "clock", title: clock }, clock && `${clock.slice(11, 19)}Z`),
      el("span", { class: "what" }, describe(event)),
    );
    this.element.prepend(line);
    while (this.element.childElementCount > MAX_LINES) {
      this.element.lastElementChild?.remove();
    }
  }
}
