/** The current numbers of a swarm. */
import { el, setText } from "../ui/dom.ts";
import { angle, fixed, signed, time } from "../ui/format.ts";
import type { Moment } from "./history.ts";

const NAMES = {
  order: "alignment of the group, from 0 to 1",
  drift: "speed along the common direction of the informed",
  direction:
    "common direction of the informed, counter-clockwise from +x, and its strength if they disagree",
  contacts: "pairs near enough to constrain, of the last step",
  n: "individuals",
  informed: "individuals with a preferred direction",
  time: "simulated time, step · dt",
  step: "steps taken",
  "real-time factor": "time units per second",
} as const;

type Name = keyof typeof NAMES;

/** The strength from which on the informed agree, as far as two decimals show. */
const AGREED = 0.995;

/** The common direction of the informed, in words if there is none. */
export function directionOf({ direction, direction_strength: strength }: Moment): string {
  const agreement = strength !== null && strength < AGREED ? `strength ${fixed(strength, 2)}` : "";
  if (direction !== null) {
    return [angle(direction), agreement].filter(Boolean).join(", ");
  }
  return agreement === "" ? "–" : `none, ${agreement}`;
}

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

  show(newest: Moment): void {
    this.put("order", fixed(newest.order, 3));
    this.put("drift", signed(newest.drift, 3));
    this.put("direction", directionOf(newest));
    this.put("contacts", fixed(newest.contacts, 0));
    this.put("n", String(newest.n));
    this.put("informed", String(newest.informed));
    this.put("time", time(newest.time));
    this.put("step", String(newest.step));
    this.put("real-time factor", fixed(newest.real_time_factor, 2));
  }

  private put(name: Name, text: string): void {
    setText(this.places.get(name)!, text);
  }
}
