/** The paper's animations: a card each, made with one click. */
import { attempt } from "../parts/announce.ts";
import { el, say } from "../parts/dom.ts";
import type { Page } from "../parts/router.ts";
import type { Session } from "../parts/session.ts";
import { tokenNote } from "../parts/token_dialog.ts";
import { animationPage, start } from "./animation.ts";
import { ANIMATIONS } from "./animations.ts";

export function galleryPage(name: string | null, session: Session): Page {
  const animation = ANIMATIONS.find((it) => it.swarm === name);
  return animation ? animationPage(animation, session) : cardsPage(session);
}

function cardsPage(session: Session): Page {
  const note = tokenNote(session);
  const buttons = new Map<string, HTMLButtonElement>();
  let there = new Set<string>();
  const cards = ANIMATIONS.map((animation) => {
    const { swarm, reference, title, look } = animation;
    const button = el("button", { type: "button", class: "primary" });
    button.addEventListener("click", async () => {
      if (there.has(swarm) || (await attempt(() => start(animation)))) {
        location.hash = `#/gallery/${swarm}`;
      }
    });
    buttons.set(swarm, button);
    return el(
      "article",
      { class: "card animation", "data-swarm": swarm },
      el("header", {}, el("h2", {}, title), el("span", { class: "soft" }, reference)),
      el("p", {}, look),
      el("p", { class: "buttons" }, button),
    );
  });
  const element = el(
    "div",
    { class: "page gallery-page" },
    el("header", { class: "page-head" }, el("h1", {}, "Gallery")),
    el(
      "p",
      { class: "lead" },
      "Seven animations are attached to the paper: five that show what π3, how quickly individuals " +
        "turn, and π4, how easily contacts turn them, do to a group [35], and two of groups in which " +
        "nobody has a direction of its own [39]. Each can be had here, alive.",
    ),
    note,
    el("div", { class: "cards wide-cards" }, ...cards),
    el(
      "p",
      { class: "soft" },
      "Specs and seeds are those of paper/animations.toml, dt = 0.02 and exact contacts. The " +
        "paper does not say how many individuals [35] has nor who is informed: here fifty, ten of " +
        "them told of +x with weight 0.5; in the tables of docs/reproduction.md nobody is.",
    ),
  );
  const refresh = () => {
    note.hidden = session.mayCommand;
    for (const [swarm, button] of buttons) {
      const exists = there.has(swarm);
      say(button, exists ? "Show it" : "Create and run it");
      button.disabled = !exists && !session.mayCommand;
    }
  };
  session.live.watch(null);
  const ends = [
    session.live.listen({
      swarms: (rows) => {
        there = new Set(rows.map((row) => row.swarm));
        refresh();
      },
      connection: (connection) => element.classList.toggle("dimmed", connection === "away"),
    }),
    session.onChange(refresh),
  ];
  const end = () => {
    for (const stop of ends) {
      stop();
    }
  };
  return { element, title: "Gallery", end };
}
