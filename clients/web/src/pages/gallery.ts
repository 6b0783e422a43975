/** The paper's animations: one card each, with a button that creates the swarm. */
import { Thumbnails } from "../panels/thumbnails.ts";
import { attempt } from "../ui/announce.ts";
import { button, callAll, el, setText } from "../ui/dom.ts";
import type { Page } from "../ui/router.ts";
import type { Session } from "../ui/session.ts";
import { tokenNote } from "../ui/token_dialog.ts";
import { animationPage, start } from "./animation.ts";
import { ANIMATIONS } from "./animations.ts";

export function galleryPage(name: string | null, session: Session): Page {
  const animation = ANIMATIONS.find((it) => it.swarm === name);
  return animation ? animationPage(animation, session) : cardsPage(session);
}

function cardsPage(session: Session): Page {
  const note = tokenNote(session);
  let existing = new Set<string>();
  const thumbnails = new Thumbnails();
  const cards = ANIMATIONS.map((animation) => {
    const { swarm, reference, title, look } = animation;
    const open = async () => {
      if (existing.has(swarm) || (await attempt(() => start(animation)))) {
        location.hash = `#/gallery/${swarm}`;
      }
    };
    const show = button("", open, "primary");
    const canvas = el("canvas", { "aria-hidden": "true" });
    const picture = el(
      "div",
      { class: "thumbnail" },
      el("span", { class: "large" }, "not created"),
      canvas,
    );
    const card = el(
      "article",
      { class: "card animation", "data-swarm": swarm },
      picture,
      el("header", {}, el("h2", {}, title), el("span", { class: "soft" }, reference)),
      el("p", {}, look),
      el("p", { class: "buttons" }, show),
    );
    thumbnails.add(card, swarm, canvas);
    return { swarm, card, canvas, show };
  });
  const grid = el("div", { class: "cards wide-cards" }, ...cards.map(({ card }) => card));
  const element = el(
    "div",
    { class: "page gallery-page" },
    el("header", { class: "page-head" }, el("h1", {}, "Gallery")),
    el(
      "p",
      { class: "lead" },
      "The paper has seven animations: five show the effect of π3, how quickly individuals turn, and " +
        "π4, how easily contacts turn them [35]; two show groups without informed individuals [39]. " +
        "Each card creates and runs that swarm on this daemon.",
    ),
    note,
    grid,
    el(
      "p",
      { class: "soft" },
      "Specs and seeds are those of paper/animations.toml, dt = 0.02 and exact contacts. The " +
        "paper does not give the number of individuals in [35] nor which are informed: here n = 50, " +
        "ten of them informed of +x with weight 0.5; in the tables of docs/reproduction.md none is.",
    ),
  );
  const refresh = () => {
    note.hidden = session.mayCommand;
    for (const { swarm, show } of cards) {
      const exists = existing.has(swarm);
      setText(show, exists ? "Show" : "Create and run");
      show.disabled = !exists && !session.mayCommand;
    }
  };
  session.live.watch(null);
  thumbnails.follow(session.live, element, (rows) => {
    existing = new Set(rows.map((row) => row.swarm));
    refresh();
    for (const { swarm, card, canvas } of cards) {
      const row = rows.find((it) => it.swarm === swarm) ?? null;
      canvas.hidden = row === null;
      thumbnails.show(card, row);
    }
    // Without any animation the thumbnails would all be empty.
    grid.classList.toggle(
      "pictured",
      ANIMATIONS.some(({ swarm }) => existing.has(swarm)),
    );
  });
  const ends = [session.onChange(refresh), () => thumbnails.end()];
  return { element, title: "Gallery", end: () => callAll(ends) };
}
