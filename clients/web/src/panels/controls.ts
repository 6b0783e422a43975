/** Run, pause, step, rate, inject, fork, reset, delete, annotate. */
import { announce, attempt } from "../parts/announce.ts";
import { confirmDialog } from "../parts/dialog.ts";
import { el, say } from "../parts/dom.ts";
import { form, nameField, numberField, numberIn, textField } from "../parts/field.ts";
import { plural } from "../parts/format.ts";
import type { Session } from "../parts/session.ts";
import { tokenNote } from "../parts/token_dialog.ts";
import { command } from "../wire/http.ts";
import type { Phase, SwarmRow } from "../wire/messages.ts";

/** The longest text of `annotate`. */
const MAX_NOTE_CHARACTERS = 1000;

export class Controls {
  readonly element: HTMLElement;
  private phase: Phase = "paused";
  private there = false;
  private rateShown = "";
  private readonly runs = el("button", { type: "button", class: "primary wide" }, "▶ Run");
  private readonly steps = numberField({
    label: "steps",
    value: "1",
    min: "1",
    step: "1",
    required: true,
  });
  private readonly rate = numberField({
    label: "rate",
    unit: "time units / s",
    min: "0",
    placeholder: "max",
  });
  private readonly fields: HTMLFieldSetElement;
  private readonly text = textField("note in the journal", MAX_NOTE_CHARACTERS);
  private readonly notes: HTMLFieldSetElement;
  private readonly note: HTMLElement;
  private readonly stepButton = el("button", {}, "Step");
  private readonly changing: HTMLElement[];

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
  ) {
    this.note = tokenNote(session);
    this.runs.addEventListener("click", () => void this.toggle());
    const count = numberField({
      label: "individuals to inject",
      value: "1",
      min: "1",
      step: "1",
      required: true,
    });
    const fork = nameField("name of the fork", `${swarm.slice(0, 58)}-fork`);
    const remove = el("button", { type: "button", class: "danger" }, "Delete …");
    const reset = el("button", { type: "button" }, "Reset …");
    remove.addEventListener("click", () => void this.delete());
    reset.addEventListener("click", () => void this.reset());
    const inject = () =>
      attempt(
        () => command(swarm, "inject", { count: count.input.valueAsNumber }),
        `${plural(count.input.valueAsNumber, "individual")} injected`,
      );
    this.changing = [
      form({ class: "row" }, inject, count.label, el("button", {}, "Inject")),
      form(
        { class: "row" },
        () => this.fork(fork.input.value),
        fork.label,
        el("button", {}, "Fork"),
      ),
    ];
    this.fields = el(
      "fieldset",
      { class: "controls" },
      el("legend", { class: "hidden" }, "commands"),
      this.runs,
      form(
        { class: "row" },
        () => this.setRate(),
        this.rate.label,
        el("button", {}, "Run at rate"),
      ),
      form({ class: "row" }, () => this.step(), this.steps.label, this.stepButton),
      ...this.changing,
      el("p", { class: "buttons" }, reset, remove),
    );
    this.notes = el(
      "fieldset",
      { class: "controls" },
      el("legend", { class: "hidden" }, "notes"),
      form({ class: "row" }, () => this.annotate(), this.text.label, el("button", {}, "Add note")),
    );
    this.element = el("div", {}, this.note, this.fields, this.notes);
    this.rate.input.title = "empty: as fast as possible";
  }

  /** Shows what can be done in a phase; nothing when the swarm is not there. */
  show(row: Pick<SwarmRow, "phase" | "rate" | "replay"> | undefined): void {
    this.there = row !== undefined;
    // A recording has no future that could be changed.
    for (const part of this.changing) {
      part.hidden = row?.replay ?? false;
    }
    this.notes.hidden = row?.replay ?? false;
    if (row) {
      this.showPhase(row.phase, row.rate);
    }
    this.allow();
  }

  private showPhase(phase: Phase, rate: number | null): void {
    const text = rate === null ? "" : String(rate);
    if (text !== this.rateShown) {
      this.rateShown = text;
      this.rate.input.value = text;
    }
    this.phase = phase;
    say(this.runs, phase === "running" ? "❚❚ Pause" : "▶ Run");
    this.runs.disabled = phase === "faulted";
    this.stepButton.disabled = phase !== "paused";
  }

  /** Without a token nothing here can be used, and it says how to get one. */
  allow(): void {
    this.note.hidden = this.session.mayCommand;
    this.fields.disabled = !this.session.mayCommand || !this.there;
    this.notes.disabled = !this.session.mayAnnotate || !this.there;
  }

  async toggle(): Promise<void> {
    if (!this.session.mayCommand) {
      announce(this.session.refusal);
    } else if (this.phase === "running") {
      await attempt(() => command(this.swarm, "pause"), "paused");
    } else {
      await attempt(() => command(this.swarm, "run", {}), "running");
    }
  }

  async step(): Promise<void> {
    if (!this.session.mayCommand) {
      announce(this.session.refusal);
      return;
    }
    const steps = Math.max(1, numberIn(this.steps.input) ?? 1);
    const reply = await attempt(() => command(this.swarm, "step", { steps }));
    if (reply) {
      announce(`at step ${reply.step}`);
    }
  }

  private async setRate(): Promise<void> {
    const rate = numberIn(this.rate.input) ?? null;
    const said = rate === null ? "as fast as possible" : `${rate} time units a second`;
    // `run` is what changes a rate; a swarm that stands still is told when it is run.
    await attempt(() => command(this.swarm, "run", { rate }), `running, ${said}`);
  }

  private async annotate(): Promise<void> {
    const text = this.text.input.value;
    if (await attempt(() => command(this.swarm, "annotate", { text }), "note added")) {
      this.text.input.value = "";
    }
  }

  private async fork(name: string): Promise<void> {
    if (await attempt(() => command(this.swarm, "fork", { name }), `forked as ${name}`)) {
      location.hash = `#/swarm/${name}`;
    }
  }

  private async reset(): Promise<void> {
    const text = `${this.swarm} goes back to its start: step 0, as it was created.`;
    if (await confirmDialog(`Reset ${this.swarm}?`, text, "Reset")) {
      await attempt(() => command(this.swarm, "reset"), "back at the start");
    }
  }

  private async delete(): Promise<void> {
    const text = `${this.swarm} and its history are removed from the daemon. This cannot be undone.`;
    if (await confirmDialog(`Delete ${this.swarm}?`, text, "Delete")) {
      if (await attempt(() => command(this.swarm, "delete"), `${this.swarm} is deleted`)) {
        location.hash = "#/";
      }
    }
  }
}
