/** The event log: numbered, and caught up where the socket could not keep up. */
import { el } from "../parts/dom.ts";
import { short, time, when } from "../parts/format.ts";
import { get } from "../wire/http.ts";
import type { EventsResult, SwarmEvent } from "../wire/messages.ts";

/** Lines that are kept, and events that are asked for when the page is opened. */
const MOST_LINES = 300;
const AT_FIRST = 100;
const ASKED_AT_ONCE = 256;

/** An event in words. */
export function describe({ event, phase }: SwarmEvent): string {
  const said = (name: string) =>
    event[name] === null || event[name] === undefined ? "" : String(event[name]);
  const by = said("client") === "" ? "" : ` · by ${said("client")}`;
  switch (event.kind) {
    case "command":
      if (event.verb === "annotate") {
        return `note: ${String((event.args as { text?: unknown } | null)?.text)}${by}`;
      }
      return `${said("verb")} ${args(event.args)}${by}`;
    case "phase":
      return said("reason") === "" ? phase : `${phase}: ${said("reason")}`;
    case "fault":
      return `fault: ${said("reason")}`;
    case "scheduled":
      return `${said("verb")} ${args(event.args)} is to apply at step ${said("applies_at_step")}${by}`;
    case "refused": {
      const error = event.error as { message?: string } | undefined;
      return `${said("verb")} refused: ${error?.message ?? ""}${by}`;
    }
    case "lapsed":
      return `uninformed, their time being over: ${brief(event.ids)}`;
    default: {
      const rest = Object.entries(event).filter(([name]) => name !== "kind");
      return `${event.kind} ${rest.map(([name, value]) => `${name} ${brief(value)}`).join(", ")}`;
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
  return entries.map(([name, it]) => `${name} ${brief(it)}`).join(", ");
}

export class Events {
  readonly element = el("ol", {
    class: "events",
    tabindex: "0",
    "aria-label": "events, newest first",
  });
  private last = 0;
  private reading = false;
  private wanted = false;
  private ended = false;

  constructor(private readonly swarm: string) {}

  /** Shows the newest of those the daemon remembers, or what came since. */
  async catchUp(): Promise<void> {
    if (this.ended) {
      return;
    }
    if (this.reading) {
      this.wanted = true;
      return;
    }
    this.reading = true;
    try {
      do {
        this.wanted = false;
        await this.read();
      } while (this.wanted && !this.ended);
    } catch {
      // The daemon is away, or the swarm gone: the next connection asks again.
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

  private async read(): Promise<void> {
    for (;;) {
      const noun = `events?after=${this.last}&limit=${ASKED_AT_ONCE}`;
      const { events, newest } = (await get<EventsResult>(this.swarm, noun)).result;
      if (this.last === 0 && newest > AT_FIRST + ASKED_AT_ONCE) {
        this.last = newest - AT_FIRST;
        continue;
      }
      for (const event of events) {
        this.add(event);
      }
      const read = events.at(-1)?.number ?? newest;
      this.last = Math.max(this.last, read);
      if (read >= newest || events.length === 0 || this.ended) {
        return;
      }
    }
  }

  private add(event: SwarmEvent): void {
    if (event.number <= this.last) {
      return;
    }
    this.last = event.number;
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
    while (this.element.childElementCount > MOST_LINES) {
      this.element.lastElementChild?.remove();
    }
  }
}
