/** A swarm in the list: its phase, thumbnail, order and key numbers. */

import { el, setText } from "../ui/dom.ts";
import { fixed, time } from "../ui/format.ts";
import { PhaseChip } from "../ui/phase.ts";
import { Sparkline } from "../ui/sparkline.ts";
import type { SwarmSummary } from "../wire/messages.ts";
import { modelMark } from "./models.ts";
import { MAX_THUMBNAIL_N } from "./thumbnails.ts";

/** The number of points that fill the sparkline's width. */
const MIN_POINTS = 40;

export class SwarmCard {
  readonly element: HTMLAnchorElement;
  readonly canvas = el("canvas", { "aria-hidden": "true" });
  /** Whether the card is in the viewport. */
  visible = false;
  private readonly phase = new PhaseChip();
  private readonly line = new Sparkline();
  private readonly order = el("b");
  private readonly facts = el("p", { class: "facts" });
  private readonly large = el(
    "span",
    { class: "large", hidden: true },
    `no thumbnail above n = ${MAX_THUMBNAIL_N}`,
  );

  constructor(readonly swarm: string) {
    this.element = el(
      "a",
      {
        class: "card swarm-card",
        href: `#/swarm/${encodeURIComponent(swarm)}`,
        "data-swarm": swarm,
      },
      el("div", { class: "thumbnail" }, this.canvas, this.large),
      el("header", {}, el("h2", { title: swarm }, swarm), this.phase.element),
      el(
        "div",
        { class: "spark" },
        this.line.element,
        el("span", { class: "order" }, "order ", this.order),
      ),
      this.facts,
    );
  }

  show(row: SwarmSummary, orders: readonly number[]): void {
    this.phase.show(row.phase);
    const isLarge = row.n > MAX_THUMBNAIL_N;
    this.large.hidden = !isLarge;
    this.canvas.hidden = isLarge;
    this.line.show(orders, MIN_POINTS);
    setText(this.order, fixed(row.order, 2));
    const facts = [
      row.contested_by ? `contested by daemon ${row.contested_by}` : "",
      row.replay ? "playback" : "",
      row.protected ? "protected" : "",
      modelMark(row.earlier_models),
      `n ${row.n}`,
      `informed ${row.informed}`,
      `time ${time(row.time)}`,
      row.real_time_factor === null
        ? (row.reason ?? "")
        : `real-time factor ${fixed(row.real_time_factor, 1)}`,
    ];
    this.showFacts(facts.filter(Boolean));
  }
  /** One element per fact: a line breaks between facts only. */
  private showFacts(facts: string[]): void {
    while (this.facts.childElementCount > facts.length) {
      this.facts.lastElementChild?.remove();
    }
    facts.forEach((fact, k) => {
      const element = this.facts.children[k] ?? this.facts.appendChild(el("span"));
      setText(element, fact);
    });
  }
}
