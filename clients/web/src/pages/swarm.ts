/** One swarm, large, with all there is to see and to do. */
import { Charts } from "../panels/charts.ts";
import { Controls } from "../panels/controls.ts";
import { Events } from "../panels/events.ts";
import { type Moment, momentOfOrder, momentOfState } from "../panels/history.ts";
import { Numbers } from "../panels/numbers.ts";
import { Parameters } from "../panels/parameters.ts";
import { Steering } from "../panels/steering.ts";
import { Tape } from "../panels/tape.ts";
import { Watch } from "../panels/watch.ts";
import { el, say } from "../parts/dom.ts";
import { PhaseChip } from "../parts/phase.ts";
import type { Page } from "../parts/router.ts";
import type { Session } from "../parts/session.ts";

/** A part of the page that can be folded. */
function panel(title: string, kind: string, open: boolean, child: HTMLElement): HTMLElement {
  return el("details", { class: `panel ${kind}`, open }, el("summary", {}, title), child);
}

export function swarmPage(name: string, session: Session): Page {
  const phase = new PhaseChip();
  const reason = el("span", { class: "soft reason" });
  const numbers = new Numbers();
  const charts = new Charts();
  const parameters = new Parameters(name);
  let events = new Events(name);
  const log = el("div", {}, events.element);
  /** Another swarm of this name numbers its events anew. */
  const renew = () => {
    events.end();
    events = new Events(name);
    log.replaceChildren(events.element);
  };
  const controls = new Controls(name, session);
  const tape = new Tape(name, session);
  let replay = false;
  const informing = el("div", {});
  const informs = panel("Inform", "", true, informing);

  let factor: number | null = null;
  const show = (newest: Moment) => {
    numbers.show(newest);
    charts.take(newest);
  };

  const watch = new Watch(name, session, {
    state: (state) => {
      factor = state.phase === "running" ? factor : null;
      show(momentOfState(state, factor));
      phase.show(state.phase);
    },
    order: (message) => {
      factor = message.real_time_factor;
      // A tab that is not seen draws no states: its charts go on.
      if (document.hidden) {
        show(momentOfOrder(message));
      }
    },
    row: (row) => {
      controls.show(row);
      tape.show(row);
      replay = row?.replay ?? replay;
      informs.hidden = replay;
      if (!row) {
        return;
      }
      phase.show(row.phase);
      say(reason, row.reason ?? "");
    },
    parameters: (all) => parameters.show(all, session.mayCommand && !replay),
    event: (event) => {
      if (event.event.kind === "created") {
        renew();
      }
      events.take(event);
      if (event.event.kind !== "lapsed") {
        void tape.ask();
      }
    },
    another: () => {
      renew();
      void events.catchUp();
    },
    catchUp: () => void events.catchUp(),
    changed: () => steering?.show(),
    directed: (direction) => {
      if (!replay) {
        void steering.inform(direction);
      }
    },
  });
  const steering: Steering = new Steering(name, session, watch.stage);

  informing.append(steering.element);
  const element = el(
    "div",
    { class: "page swarm-page" },
    el("header", { class: "page-head" }, el("h1", {}, name), phase.element, reason),
    el("div", { class: "seen" }, watch.element, tape.element, numbers.element, charts.element),
    el(
      "aside",
      { class: "panels" },
      panel("Control", "", true, controls.element),
      informs,
      panel("Parameters", "later", innerWidth > 900, parameters.element),
      panel("Events", "later", true, log),
    ),
  );
  void events.catchUp();
  const forget = session.onChange(() => {
    controls.allow();
    tape.allow();
    steering.show();
    if (watch.parameters.length > 0) {
      parameters.show(watch.parameters, session.mayCommand && !replay);
    }
  });

  return {
    element,
    title: name,
    key: (event) => {
      if (event.key === " ") {
        void controls.toggle();
      } else if (event.key === "s") {
        void controls.step();
      } else {
        return watch.key(event);
      }
      return true;
    },
    end: () => {
      forget();
      watch.end();
      tape.end();
      charts.end();
      events.end();
    },
  };
}
