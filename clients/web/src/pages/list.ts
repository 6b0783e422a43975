/** Every swarm of the daemon, with its order over the last minutes. */
import { el, say } from "../parts/dom.ts";
import { fixed, time } from "../parts/format.ts";
import { PhaseChip } from "../parts/phase.ts";
import type { Page } from "../parts/router.ts";
import type { Session } from "../parts/session.ts";
import { Sparkline } from "../parts/sparkline.ts";
import { tokenNote } from "../parts/token_dialog.ts";
import type { SwarmRow } from "../wire/messages.ts";
import { openCreate } from "./create.ts";

const LEAST_SHOWN = 40;

class Card {
  readonly element: HTMLAnchorElement;
  private readonly phase = new PhaseChip();
  private readonly line = new Sparkline();
  private readonly order = el("b");
  private readonly facts = el("p", { class: "facts" });

  constructor(name: string) {
    this.element = el(
      "a",
      { class: "card swarm-card", href: `#/swarm/${encodeURIComponent(name)}`, "data-swarm": name },
      el("header", {}, el("h2", {}, name), this.phase.element),
      el(
        "div",
        { class: "spark" },
        this.line.element,
        el("span", { class: "order" }, "order ", this.order),
      ),
      this.facts,
    );
  }

  show(row: SwarmRow, orders: readonly number[]): void {
    this.phase.show(row.phase);
    this.line.show(orders, LEAST_SHOWN);
    say(this.order, fixed(row.order, 2));
    const facts = [
      row.contested_by ? `contested by daemon ${row.contested_by}` : "",
      row.replay ? "replay" : "",
      `n ${row.n}`,
      `informed ${row.informed}`,
      `time ${time(row.time)}`,
      row.real_time_factor === null
        ? (row.reason ?? "")
        : `real-time factor ${fixed(row.real_time_factor, 1)}`,
    ];
    say(this.facts, facts.filter(Boolean).join(" · "));
  }
}

export function listPage(session: Session): Page {
  const cards = new Map<string, Card>();
  const grid = el("div", { class: "cards" });
  const count = el("p", { class: "soft" });
  const how = el("span", {});
  const empty = el(
    "p",
    { class: "empty", hidden: true },
    "This daemon has no swarms. ",
    how,
    el("a", { href: "#/gallery" }, "gallery"),
    ".",
  );
  const create = el("button", { type: "button", class: "primary" }, "Create a swarm …");
  create.addEventListener("click", openCreate);
  const note = tokenNote(session);
  const element = el(
    "div",
    { class: "page list-page" },
    el("header", { class: "page-head" }, el("div", {}, el("h1", {}, "Swarms"), count), create),
    note,
    empty,
    grid,
  );

  const show = (rows: SwarmRow[]) => {
    const there = new Set(rows.map((row) => row.swarm));
    for (const [name, card] of cards) {
      if (!there.has(name)) {
        card.element.remove();
        cards.delete(name);
      }
    }
    rows.forEach((row, k) => {
      let card = cards.get(row.swarm);
      if (!card) {
        card = new Card(row.swarm);
        cards.set(row.swarm, card);
      }
      if (grid.children[k] !== card.element) {
        grid.insertBefore(card.element, grid.children[k] ?? null);
      }
      card.show(row, session.orders.get(row.swarm) ?? []);
    });
    empty.hidden = rows.length > 0;
    const running = rows.filter((row) => row.phase === "running").length;
    say(
      count,
      rows.length === 0
        ? ""
        : `${rows.length} on ${session.hello?.node ?? "this daemon"}, ${running} running`,
    );
  };

  session.live.watch(null);
  const ends = [
    session.live.listen({
      swarms: show,
      connection: (connection) => element.classList.toggle("dimmed", connection === "away"),
    }),
    session.onChange(() => {
      note.hidden = session.mayCommand;
      create.hidden = !session.mayCommand;
      say(
        how,
        session.mayCommand ? "Create one, or see the " : "With a token you create one. See the ",
      );
    }),
  ];
  return {
    element,
    title: "Swarms",
    end: () => {
      for (const end of ends) {
        end();
      }
    },
  };
}
