/** Run, pause, step, rate, inject, fork, protect, reset, delete, annotate. */
import { announce, announceError, attempt, checkMayCommand } from "../ui/announce.ts";
import { confirmDialog } from "../ui/dialog.ts";
import { button, el, setText } from "../ui/dom.ts";
import {
  countField,
  Followed,
  nameField,
  numberField,
  numberIn,
  rowForm,
  textField,
} from "../ui/field.ts";
import { plural } from "../ui/format.ts";
import type { Session } from "../ui/session.ts";
import { tokenNote } from "../ui/token_dialog.ts";
import { command } from "../wire/http.ts";
import type { Phase, SwarmSummary } from "../wire/messages.ts";

/** The longest text of `annotate`. */
const MAX_NOTE_CHARACTERS = 1000;
/** The daemon sends the list once a second, or as soon as it has changed. */
const TOLD_MS = 2000;

export class Controls {
  readonly element: HTMLElement;
  private phase: Phase = "paused";
  private there = false;
  private rateShown = "";
  /** The phase in the reply to the newest command and its step, and until when an older list may contradict it. */
  private told: { phase: Phase; step: number; until: number } | null = null;
  private stepShown = 0;
  private isReplay = false;
  private isProtected = false;
  private readonly rateFollows: Followed;
  /** The steps that were asked for and not replied to. */
  private stepsDue = 0;
  /** Closes the dialog that asks for a confirmation, while it is open. */
  private asking: AbortController | null = null;
  private readonly runs = button("▶ Run", () => this.toggle(), "primary wide");
  private readonly steps = countField("steps");
  private readonly rate = numberField({
    label: "rate",
    unit: "time units / s",
    min: "0",
    placeholder: "max",
  });
  private readonly fields: HTMLFieldSetElement;
  private readonly text = textField("note in the journal", {
    maxlength: String(MAX_NOTE_CHARACTERS),
  });
  private readonly notes: HTMLFieldSetElement;
  private readonly note: HTMLElement;
  private readonly stepButton = el("button", {}, "Step");
  private readonly resets = button("Reset …", () => this.reset());
  private readonly deletes = button("Delete …", () => this.delete(), "danger");
  private readonly protects = button("Protect", () => this.protect());
  private readonly protection = el(
    "p",
    { class: "soft protection", hidden: true },
    "Protected from Reset and Delete.",
  );
  private readonly changing: HTMLElement[];

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
    /** Whether the swarm of this name is still the one that the page shows. */
    private readonly isSame: () => Promise<boolean>,
  ) {
    this.note = tokenNote(session);
    const count = countField("individuals to inject");
    const fork = nameField("name of the fork", `${swarm.slice(0, 58)}-fork`);
    const inject = () =>
      attempt(
        () => command(swarm, "inject", { count: count.input.valueAsNumber }),
        `${plural(count.input.valueAsNumber, "individual")} injected`,
      );
    this.changing = [
      rowForm(inject, count.label, el("button", {}, "Inject")),
      rowForm(() => this.fork(fork.input.value), fork.label, el("button", {}, "Fork")),
    ];
    const rateForm = rowForm(
      () => this.setRate(),
      this.rate.label,
      el("button", {}, "Run at rate"),
    );
    this.rateFollows = new Followed(rateForm, () => {
      this.rate.input.value = this.rateShown;
    });
    this.fields = el(
      "fieldset",
      { class: "controls" },
      el("legend", { class: "hidden" }, "commands"),
      this.runs,
      rateForm,
      rowForm(() => this.step(), this.steps.label, this.stepButton),
      ...this.changing,
      this.protection,
      el("p", { class: "buttons" }, this.resets, this.deletes, this.protects),
    );
    this.notes = el(
      "fieldset",
      { class: "controls" },
      el("legend", { class: "hidden" }, "notes"),
      rowForm(() => this.annotate(), this.text.label, el("button", {}, "Add note")),
    );
    this.element = el("div", {}, this.note, this.fields, this.notes);
    this.rate.input.title = "empty: as fast as possible";
  }

  /** Enables what the phase permits; nothing if there is no such swarm. */
  show(
    row: Pick<SwarmSummary, "phase" | "step" | "rate" | "replay" | "protected"> | undefined,
  ): void {
    this.there = row !== undefined;
    if (!row) {
      this.forget();
    }
    // The individuals of a recording cannot be changed.
    for (const part of this.changing) {
      part.hidden = row?.replay ?? false;
    }
    this.notes.hidden = row?.replay ?? false;
    this.protects.hidden = row?.replay ?? false;
    if (row) {
      this.showRate(row.rate);
      this.stepShown = row.step;
      this.isReplay = row.replay ?? false;
      this.showProtection(row.protected ?? false);
      const { told } = this;
      // At a later step the list is newer than the reply.
      if (
        told &&
        (told.phase === row.phase || told.step < row.step || told.until < performance.now())
      ) {
        this.told = null;
      }
      this.showPhase(this.told?.phase ?? row.phase);
    }
    this.allow();
  }

  private showRate(rate: number | null): void {
    const text = rate === null ? "" : String(rate);
    const changed = text !== this.rateShown;
    this.rateShown = text;
    this.rateFollows.show(changed);
  }

  /** Sends a command, and shows the phase in its reply before the next list does. */
  private async change(verb: string, args: object, done: string): Promise<boolean> {
    const reply = await attempt(() => command(this.swarm, verb, args), done);
    // A slow reply is older than what the list has told. A playback may begin again.
    if (reply && (this.isReplay || reply.step >= this.stepShown)) {
      this.told = { phase: reply.phase, step: reply.step, until: performance.now() + TOLD_MS };
      this.showPhase(reply.phase);
    }
    return reply !== null;
  }

  private showPhase(phase: Phase): void {
    this.phase = phase;
    setText(this.runs, phase === "running" ? "❚❚ Pause" : "▶ Run");
    this.runs.disabled = phase === "faulted";
    this.stepButton.disabled = phase !== "paused";
  }

  /** A protected swarm rejects both commands: the page does not ask for a confirmation in vain. */
  private showProtection(isProtected: boolean): void {
    this.isProtected = isProtected;
    this.protection.hidden = !isProtected;
    setText(this.protects, isProtected ? "End protection" : "Protect");
    for (const it of [this.resets, this.deletes]) {
      it.disabled = isProtected;
      it.title = isProtected ? "protected: end the protection first" : "";
    }
  }

  /** Disables everything in a tab without permission, and shows how to get it. */
  allow(): void {
    this.note.hidden = this.session.mayCommand;
    this.fields.disabled = !this.session.mayCommand || !this.there;
    this.notes.disabled = !this.session.may("annotate") || !this.there;
  }

  async toggle(): Promise<void> {
    if (!checkMayCommand(this.session)) {
      return;
    }
    const isRunning = this.phase === "running";
    const done = isRunning ? "paused" : "running";
    await this.change(isRunning ? "pause" : "run", {}, done);
  }

  async step(): Promise<void> {
    if (!checkMayCommand(this.session)) {
      return;
    }
    const steps = Math.max(1, numberIn(this.steps.input) ?? 1);
    this.stepsDue += steps;
    // While a step is executed, the swarm rejects another one: it follows the reply.
    if (this.stepsDue > steps) {
      return;
    }
    while (this.stepsDue > 0) {
      const sent = this.stepsDue;
      const reply = await attempt(() => command(this.swarm, "step", { steps: sent }));
      this.stepsDue = reply ? this.stepsDue - sent : 0;
      if (reply) {
        announce(`at step ${reply.step}`);
      }
    }
  }

  private async setRate(): Promise<void> {
    const rate = numberIn(this.rate.input) ?? null;
    const speed = rate === null ? "as fast as possible" : `${rate} time units per second`;
    // The rate is an argument of `run`: a paused swarm starts.
    this.rateFollows.sent(await this.change("run", { rate }, `running, ${speed}`));
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

  private async protect(): Promise<void> {
    const on = !this.isProtected;
    const done = on ? "protected from Reset and Delete" : "no longer protected";
    // The list shows it, as soon as it has changed.
    await attempt(() => command(this.swarm, "protect", { on }), done);
  }

  private async reset(): Promise<void> {
    const text = `${this.swarm} returns to step 0, as it was created.`;
    await this.confirmed("Reset", text, "reset to step 0");
  }

  private async delete(): Promise<void> {
    const text = `${this.swarm} and its history are removed from the daemon. This cannot be undone.`;
    if (await this.confirmed("Delete", text, `${this.swarm} is deleted`)) {
      location.hash = "#/";
    }
  }

  /** Sends a command after a confirmation, if the swarm is still the one that the dialog was about. */
  private async confirmed(verb: string, text: string, done: string): Promise<boolean> {
    this.asking = new AbortController();
    const agreed = await confirmDialog(`${verb} ${this.swarm}?`, text, verb, this.asking.signal);
    this.asking = null;
    // The daemon cannot tell: epoch and step of another swarm may be the same.
    const send = async () => {
      if (!(await this.isSame())) {
        throw this.replaced();
      }
      return command(this.swarm, verb.toLowerCase());
    };
    return agreed && (await attempt(send, done)) !== null;
  }

  private replaced(): Error {
    return new Error(`the ${this.swarm} that you saw was deleted meanwhile: no command was sent`);
  }

  /** The swarm was deleted: a dialog about it closes. */
  forget(): void {
    if (this.asking) {
      this.end();
      announceError(this.replaced());
    }
  }

  end(): void {
    this.asking?.abort();
  }
}
