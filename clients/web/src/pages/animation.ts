/** The page of one animation: the picture, what to look for, and numbers. */
import { touchingShare } from "../geometry/touching.ts";
import { inform } from "../panels/inform.ts";
import { Watch } from "../panels/watch.ts";
import { attempt, checkMayCommand } from "../ui/announce.ts";
import { button, el, setText } from "../ui/dom.ts";
import { fixed, signed, time } from "../ui/format.ts";
import { PhaseChip } from "../ui/phase.ts";
import type { Page } from "../ui/router.ts";
import type { Session } from "../ui/session.ts";
import { tokenNote } from "../ui/token_dialog.ts";
import { command, commandNode, RequestError } from "../wire/http.ts";
import type { SwarmSummary } from "../wire/messages.ts";
import type { State } from "../wire/state.ts";
import { ANIMATIONS, type Animation } from "./animations.ts";

/** Creates the swarm, informs individuals and runs it. An existing swarm is left unchanged. */
export async function start({ swarm, spec, informed }: Animation): Promise<true> {
  try {
    await commandNode("create", { name: swarm, spec });
  } catch (error) {
    if (error instanceof RequestError && error.code === "already_exists") {
      return true;
    }
    throw error;
  }
  if (informed > 0) {
    await command(swarm, "inform", { select: { count: informed }, direction: 0 });
  }
  await command(swarm, "run");
  return true;
}

/** The minimum time between two counts of the individuals that touch another. */
const COUNT_MS = 200;

const NUMBERS = [
  "order",
  "drift",
  "contacts per individual",
  "share touching another",
  "time",
] as const;

export function animationPage(animation: Animation, session: Session): Page {
  const { swarm, title, reference, look, informed } = animation;
  const phase = new PhaseChip();
  const places = NUMBERS.map((name) => [name, el("dd", { "data-number": name }, "–")] as const);
  const numbers = new Map(places);
  const put = (name: (typeof NUMBERS)[number], text: string) => setText(numbers.get(name)!, text);
  let counted = Number.NEGATIVE_INFINITY;
  let counting: ReturnType<typeof setTimeout> | undefined;
  let row: SwarmSummary | undefined;
  const showState = (state: State) => {
    phase.show(state.phase);
    const n = state.id.length;
    put("order", fixed(state.order.order, 3));
    put("drift", state.order.drift === null ? "undefined" : signed(state.order.drift, 3));
    put("time", time(state.time));
    put("contacts per individual", fixed(state.certificate.contacts / n, 2));
    clearTimeout(counting);
    // Later if it is too soon, since no other state may come.
    counting = setTimeout(count, Math.max(0, counted + COUNT_MS - performance.now()));
  };
  const count = () => {
    counted = performance.now();
    const n = watch.view.state?.id.length ?? 0;
    put("share touching another", `${fixed(100 * touchingShare(n, watch.view.pairs()), 0)} %`);
  };
  const run = button("", () => toggle(), "primary");
  const note = tokenNote(session);
  const refresh = () => {
    note.hidden = session.mayCommand;
    run.disabled = !session.mayCommand || row?.phase === "faulted";
    setText(run, !row ? "Create and run" : row.phase === "running" ? "❚❚ Pause" : "▶ Run");
  };
  const watch: Watch = new Watch(swarm, session, {
    state: showState,
    row: (it) => {
      row = it;
      if (it) {
        phase.show(it.phase);
      }
      refresh();
    },
    directed: (direction) => void inform(swarm, session, [...watch.view.selected], { direction }),
  });
  watch.view.layers.preferences = animation.preferences;
  watch.toolbar.show();

  const toggle = async () => {
    if (!checkMayCommand(session)) {
      return;
    }
    if (!row) {
      await attempt(() => start(animation));
      session.live.reconnect();
    } else {
      await attempt(() => command(swarm, row?.phase === "running" ? "pause" : "run"));
    }
  };
  const at = ANIMATIONS.indexOf(animation);
  const link = (it: Animation | undefined, text: string) =>
    it ? el("a", { href: `#/gallery/${it.swarm}` }, text) : el("span", {});
  const element = el(
    "div",
    { class: "page swarm-page show-page" },
    el(
      "header",
      { class: "page-head" },
      el("h1", {}, title),
      phase.element,
      el("span", { class: "soft" }, reference),
    ),
    el("div", { class: "seen" }, watch.element),
    el(
      "aside",
      { class: "panels" },
      el("section", { class: "panel" }, el("h2", {}, "What to look for"), el("p", {}, look)),
      el(
        "section",
        { class: "panel" },
        el("h2", {}, "Now"),
        el(
          "dl",
          { class: "numbers" },
          ...places.map(([name, place]) => el("div", {}, el("dt", {}, name), place)),
        ),
      ),
      el(
        "section",
        { class: "panel" },
        note,
        el(
          "p",
          { class: "buttons" },
          run,
          el("a", { class: "button", href: `#/swarm/${swarm}` }, "Open the swarm"),
        ),
        el(
          "p",
          { class: "soft" },
          informed > 0 ? `n = 50, ${informed} informed of +x. ` : "n = 50, none informed. ",
          animation.preferences
            ? "Red lines: the preference vector of each individual, from the attraction to all others and its preferred direction."
            : "",
        ),
      ),
      el(
        "nav",
        { class: "between", "aria-label": "animations" },
        link(ANIMATIONS[at - 1], "← previous"),
        el("a", { href: "#/gallery" }, "all animations"),
        link(ANIMATIONS[at + 1], "next →"),
      ),
    ),
  );
  const forget = session.onChange(refresh);
  return {
    element,
    title,
    key: (event) => {
      if (event.key === " ") {
        void toggle();
        return true;
      }
      return watch.key(event);
    },
    end: () => {
      forget();
      clearTimeout(counting);
      watch.end();
    },
  };
}
