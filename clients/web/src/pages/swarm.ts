/** The page of one swarm: picture, numbers, charts and all panels. */
import { Charts } from "../panels/charts.ts";
import { Conditions } from "../panels/conditions.ts";
import { Controls } from "../panels/controls.ts";
import { downloadButton } from "../panels/download.ts";
import { Events } from "../panels/events.ts";
import { type Moment, momentOfOrder, momentOfState } from "../panels/history.ts";
import { modelMark } from "../panels/models.ts";
import { Numbers } from "../panels/numbers.ts";
import { Parameters } from "../panels/parameters.ts";
import { Playback } from "../panels/playback.ts";
import { Steering } from "../panels/steering.ts";
import { Verify } from "../panels/verify.ts";
import { Watch } from "../panels/watch.ts";
import { el, setText } from "../ui/dom.ts";
import { PhaseChip } from "../ui/phase.ts";
import type { Page } from "../ui/router.ts";
import type { Session } from "../ui/session.ts";

/** A collapsible section of the page. */
function panel(title: string, kind: string, open: boolean, child: HTMLElement): HTMLElement {
  return el("details", { class: `panel ${kind}`, open }, el("summary", {}, title), child);
}

export function swarmPage(name: string, session: Session): Page {
  const phase = new PhaseChip();
  const reason = el("span", { class: "soft reason" });
  const kept = el("span", { class: "soft kept", hidden: true }, "protected");
  const models = el("span", { class: "soft kept", hidden: true });
  models.title =
    "An earlier version of the model computed its steps up to there: jostle verify and fork begin later";
  const numbers = new Numbers();
  const charts = new Charts(name);
  const parameters = new Parameters(name);
  let events = new Events(name, () => takeAnother(newest));
  const log = el("div", {}, events.element);
  const download = downloadButton(name);
  const verify = new Verify(name);
  const again = el(
    "div",
    {},
    el("p", { class: "buttons" }, download, verify.button),
    verify.element,
  );
  /** The event numbers of another swarm of this name start at 1. */
  const replaceEvents = () => {
    events.end();
    events = new Events(name, () => takeAnother(newest));
    log.replaceChildren(events.element);
  };
  const controls = new Controls(name, session, () => events.isSame());
  const playback = new Playback(name, session);
  const conditions = new Conditions(name, session);
  const conditionPanel = panel("When a condition holds", "", innerWidth > 900, conditions.element);
  let replay = false;
  const informing = el("div", {});
  const informs = panel("Inform", "", true, informing);

  let exists = false;
  const refreshConditions = () => {
    if (exists) {
      void conditions.refresh();
    }
  };
  const catchUp = (again = false) => {
    void events.catchUp(again);
    void playback.refresh();
    refreshConditions();
  };

  let newest: Moment | null = null;
  /** The swarm of this name is another one; `its` are its numbers, if they are known. */
  const takeAnother = (its: Moment | null) => {
    charts.clear();
    if (its) {
      charts.add(its);
    }
    watch.view.forget();
    controls.forget();
    replaceEvents();
    catchUp();
  };

  let factor: number | null = null;
  const show = (moment: Moment) => {
    newest = moment;
    numbers.show(moment);
    charts.add(moment);
  };

  const watch = new Watch(name, session, {
    state: (state) => {
      factor = state.phase === "running" ? factor : null;
      show(momentOfState(state, factor));
      phase.show(state.phase);
    },
    order: (message) => {
      factor = message.real_time_factor;
      // A hidden tab draws no states; its charts continue with the published orders.
      if (document.hidden) {
        show(momentOfOrder(message));
      }
    },
    row: (row) => {
      controls.show(row);
      playback.show(row);
      replay = row?.replay ?? replay;
      informs.hidden = replay;
      conditionPanel.hidden = replay;
      again.hidden = replay;
      const isNew = !exists;
      exists = row !== undefined;
      phase.element.hidden = row === undefined;
      if (!row) {
        return;
      }
      if (isNew) {
        refreshConditions();
      }
      phase.show(row.phase);
      setText(reason, row.reason ?? "");
      kept.hidden = !(row.protected ?? false);
      setText(models, modelMark(row.earlier_models));
      models.hidden = models.textContent === "";
    },
    parameters: (all) => {
      parameters.show(all, session.mayCommand && !replay);
      conditions.offer(all);
    },
    event: (event) => {
      if (event.event.kind === "created") {
        replaceEvents();
      }
      events.take(event);
      if (event.event.kind !== "lapsed") {
        void playback.refresh();
      }
      exists &&= event.event.kind !== "deleted";
      refreshConditions();
    },
    replaced: () => takeAnother(null),
    catchUp,
    changed: () => steering?.show(),
    directed: (direction) => {
      if (!replay) {
        void steering.inform(direction);
      }
    },
  });
  const steering: Steering = new Steering(name, session, watch.view);

  informing.append(steering.element);
  const element = el(
    "div",
    { class: "page swarm-page" },
    el("header", { class: "page-head" }, el("h1", {}, name), phase.element, reason, kept, models),
    el("div", { class: "seen" }, watch.element, playback.element, numbers.element, charts.element),
    el(
      "aside",
      { class: "panels" },
      el(
        "div",
        { class: "panel-column" },
        panel("Control", "", true, controls.element),
        informs,
        conditionPanel,
        panel("Events", "later log", true, el("div", {}, log, again)),
      ),
      el(
        "div",
        { class: "panel-column" },
        panel("Parameters", "later", innerWidth > 900, parameters.element),
      ),
    ),
  );
  catchUp();
  const forget = session.onChange(() => {
    controls.allow();
    playback.allow();
    conditions.allow();
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
      controls.end();
      playback.end();
      charts.end();
      events.end();
      verify.end();
    },
  };
}
