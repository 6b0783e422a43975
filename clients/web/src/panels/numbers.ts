/** What a swarm is at now, in numbers. */
import { el, say } from "../parts/dom.ts";
import { fixed, signed, time } from "../parts/format.ts";
import type { OrderMessage, SwarmRow } from "../wire/messages.ts";
import type { State } from "../wire/state.ts";

const NAMES = {
  order: "alignment of the group, from 0 to 1",
  drift: "speed along the informed's common direction",
  contacts: "pairs near enough to constrain, of the last step",
  n: "individuals",
  informed: "individuals with a direction of their own",
  time: "step · dt",
  step: "steps taken",
  "real-time factor": "time units a second",
} as const;

type Name = keyof typeof NAMES;

export class Numbers {
  readonly element = el("dl", { class: "numbers" });
  private readonly places = new Map<Name, HTMLElement>();

  constructor() {
    for (const [name, about] of Object.entries(NAMES)) {
      const place = el("dd", { "data-number": name }, "–");
      this.places.set(name as Name, place);
      this.element.append(el("div", { title: about }, el("dt", {}, name), place));
    }
  }

  showState(state: State): void {
    this.put("order", fixed(state.order.order, 3));
    this.put("drift", signed(state.order.drift, 3));
    this.put("contacts", String(state.certificate.contacts));
    this.put("n", String(state.id.length));
    this.put("informed", String(state.weight.reduce((sum, it) => sum + (it > 0 ? 1 : 0), 0)));
    this.put("time", time(state.time));
    this.put("step", String(state.step));
  }

  showOrder(message: OrderMessage): void {
    this.put("real-time factor", fixed(message.real_time_factor, 2));
  }

  showRow(row: SwarmRow): void {
    this.put("real-time factor", fixed(row.real_time_factor, 2));
  }

  private put(name: Name, text: string): void {
    say(this.places.get(name)!, text);
  }
}
