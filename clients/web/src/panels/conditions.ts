/** The panel of conditions: those that wait, and a form that adds one with its action. */
import { announce, announceError, checkMayCommand } from "../ui/announce.ts";
import { button, el, setText } from "../ui/dom.ts";
import { form, numberField, selectField, textField } from "../ui/field.ts";
import type { Session } from "../ui/session.ts";
import { command, get, RequestError } from "../wire/http.ts";
import type { Parameter, Status, WaitingCondition } from "../wire/messages.ts";

const ACTIONS = ["pause", "inform", "uninform", "set"] as const;

type Action = (typeof ACTIONS)[number];

/** The daemon's limit. */
const MAX_LENGTH = 1000;

export class Conditions {
  readonly element: HTMLElement;
  private readonly waiting = el("ul", { class: "waiting", "aria-label": "waiting conditions" });
  private readonly none = el("p", { class: "soft" }, "No condition waits.");
  private readonly remove = button("Remove all", () => this.cancel());
  private readonly condition = textField("condition", {
    placeholder: "order > 0.9 for 20",
    maxlength: String(MAX_LENGTH),
    autocapitalize: "off",
    spellcheck: "false",
    "aria-describedby": "condition-error",
  });
  private readonly error = el("p", { class: "form-error", id: "condition-error", role: "alert" });
  private readonly action = selectField("action", ACTIONS);
  private readonly share = numberField({
    label: "share",
    value: "0.2",
    min: "0",
    max: "1",
    required: true,
  });
  private readonly direction = numberField({
    label: "direction",
    unit: "(°)",
    value: "0",
    required: true,
  });
  private readonly parameter = selectField("parameter", []);
  private readonly value = numberField({ label: "value", value: "", required: true });
  private readonly details = el("div", { class: "row" });
  private readonly fields: HTMLFieldSetElement;
  private number = 0;
  private shown = "";
  /** The parameters that `set` changes to a number, with their present values. */
  private numbers = new Map<string, string>();

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
  ) {
    this.action.select.addEventListener("change", () => this.showDetails());
    const { select } = this.parameter;
    select.addEventListener("change", () => this.fillValue());
    this.condition.input.addEventListener("input", () => this.reject(""));
    this.fields = el(
      "fieldset",
      {},
      el("legend", { class: "hidden" }, "wait for a condition"),
      form(
        "lines",
        () => this.add(),
        this.condition.label,
        this.error,
        el("div", { class: "row" }, this.action.label, this.details),
        el("button", { class: "primary" }, "Add condition"),
      ),
    );
    this.element = el(
      "div",
      { class: "conditions" },
      this.fields,
      el("div", { class: "waits", "aria-live": "polite" }, this.none, this.waiting, this.remove),
    );
    this.showDetails();
    this.reject("");
    this.show([]);
    this.allow();
  }

  /** Enables what this tab may do. */
  allow(): void {
    this.fields.disabled = !this.session.mayCommand;
    this.remove.disabled = !this.session.mayCommand;
    for (const it of this.waiting.querySelectorAll("button")) {
      it.disabled = !this.session.mayCommand;
    }
  }

  /** Offers the parameters that `set` changes to a number. */
  offer(parameters: Parameter[]): void {
    // Longer bodies need room, for which the panel of parameters has an option.
    const numbers = parameters.filter(
      (it) => it.kind === "number" && it.changed_by.includes("set") && it.name !== "pi1",
    );
    const { select } = this.parameter;
    const names = numbers.map((it) => it.name);
    const isNew = names.join() !== [...this.numbers.keys()].join();
    this.numbers = new Map(numbers.map((it) => [it.name, String(it.value)]));
    if (isNew) {
      select.replaceChildren(...names.map((it) => new Option(it)));
      this.fillValue();
    }
  }

  private fillValue(): void {
    this.value.input.value = this.numbers.get(this.parameter.select.value) ?? "";
  }

  /** Shows the conditions that wait now. */
  async refresh(): Promise<void> {
    this.number += 1;
    const { number } = this;
    try {
      const { conditions } = (await get<Status>(this.swarm, "status")).result;
      if (number === this.number) {
        this.show(conditions ?? []);
      }
    } catch {
      // The page shows elsewhere that the swarm or the daemon is missing.
    }
  }

  private show(waiting: WaitingCondition[]): void {
    this.none.hidden = waiting.length > 0;
    this.remove.hidden = waiting.length === 0;
    const shown = JSON.stringify(waiting);
    if (shown !== this.shown) {
      this.shown = shown;
      this.waiting.replaceChildren(...waiting.map((it) => this.item(it)));
    }
  }

  /** A condition with what follows and whose it is, and the button that removes it. */
  private item(waiting: WaitingCondition): HTMLElement {
    const { id, condition, action, event, client, evaluated } = waiting;
    const does = action === "event" ? `event ${event ?? ""}` : action;
    const what = evaluated === false ? `${does} (not evaluated)` : does;
    const remove = button("Remove", () => this.cancel(id));
    remove.disabled = !this.session.mayCommand;
    remove.setAttribute("aria-label", `remove the condition ${condition}`);
    const of = client === null ? "" : `, of ${client}`;
    return el("li", {}, el("code", {}, condition), ` ${what}${of} `, remove);
  }

  private showDetails(): void {
    const fields: Record<Action, Node[]> = {
      pause: [],
      inform: [this.share.label, this.direction.label],
      uninform: [el("small", {}, "all informed individuals")],
      set: [this.parameter.label, this.value.label],
    };
    const shown = fields[this.action.select.value as Action];
    this.details.replaceChildren(...shown);
    this.details.hidden = shown.length === 0;
  }

  /** The arguments of `when` for the chosen action. */
  private does(): object {
    const change = (verb: string, args: object) => ({ commands: [{ verb, args }] });
    switch (this.action.select.value as Action) {
      case "pause":
        return { pause: true };
      case "inform": {
        const direction = (this.direction.input.valueAsNumber * Math.PI) / 180;
        const select = { fraction: this.share.input.valueAsNumber };
        return change("inform", { select, direction });
      }
      case "uninform":
        return change("uninform", { select: { informed: true } });
      case "set":
        return change("set", {
          [this.parameter.select.value]: this.value.input.valueAsNumber,
        });
    }
  }

  private async add(): Promise<void> {
    if (!checkMayCommand(this.session)) {
      return;
    }
    const { input } = this.condition;
    this.reject("");
    try {
      await command(this.swarm, "when", { condition: input.value, ...this.does() });
      announce(`waits until ${input.value}`);
      input.value = "";
    } catch (error) {
      const column = columnOf(error);
      if (column === null) {
        announceError(error);
        return;
      }
      this.reject((error as Error).message);
      // The daemon counts characters, a field UTF-16 units.
      const at = [...input.value].slice(0, column - 1).join("").length;
      input.focus();
      input.setSelectionRange(at, Math.max(at, wordEnd(input.value, at)));
    }
    // The form accepts the next condition meanwhile.
    void this.refresh();
  }

  /** Shows why the condition is invalid; an empty text if it is not. */
  private reject(problem: string): void {
    setText(this.error, problem);
    this.error.hidden = problem === "";
    this.condition.input.setAttribute("aria-invalid", String(problem !== ""));
  }

  private async cancel(id?: string): Promise<void> {
    if (!checkMayCommand(this.session)) {
      return;
    }
    try {
      await command(this.swarm, "when", id === undefined ? { cancel: true } : { cancel: true, id });
      announce(id === undefined ? "all conditions are removed" : "the condition is removed");
    } catch (error) {
      announceError(error);
    }
    await this.refresh();
  }
}

/** The column of the condition at which the daemon found an error, from 1; null for another error. */
function columnOf(error: unknown): number | null {
  if (!(error instanceof RequestError)) {
    return null;
  }
  const { field, column } = (error.body.details ?? {}) as { field?: unknown; column?: unknown };
  return field === "condition" && typeof column === "number" ? column : null;
}

/** The end of the word at a position. */
function wordEnd(text: string, at: number): number {
  const word = /^\S+/.exec(text.slice(at));
  return at + (word?.[0].length ?? 0);
}
