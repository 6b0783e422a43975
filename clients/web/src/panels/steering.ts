/** The inform panel: selects individuals, and sends `inform` and `uninform` for them. */

import type { Mode } from "../canvas/gestures.ts";
import type { View } from "../canvas/view.ts";
import { attempt } from "../ui/announce.ts";
import { button, el, setText } from "../ui/dom.ts";
import { numberField, numberIn, rowForm } from "../ui/field.ts";
import { degrees, plural } from "../ui/format.ts";
import type { Session } from "../ui/session.ts";
import { command } from "../wire/http.ts";
import { inform } from "./inform.ts";

/** What a drag on the picture does in each mode. */
const MODES: Record<Mode, string> = {
  look: "",
  lasso: "A drag on the picture selects.",
  direct: "A drag on the picture informs.",
};

export class Steering {
  readonly element: HTMLElement;
  private readonly selection = el("p", { class: "selection", "aria-live": "polite" });
  private readonly direction = numberField({
    label: "direction",
    unit: "(°)",
    value: "0",
    required: true,
  });
  private readonly weight = numberField({ label: "weight", min: "0", placeholder: "pi2" });
  private readonly fields: HTMLFieldSetElement;
  private readonly clear: HTMLButtonElement;
  private readonly lasso = button("Lasso", () => this.enter("lasso"));
  private readonly drag = button("Drag a direction", () => this.enter("direct"));
  /** Shown while a drag on the picture selects or informs. */
  private readonly mode = el("p", { class: "mode", hidden: true });
  private readonly modeText = el("span", {});

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
    private readonly view: View,
  ) {
    const { selected } = view;
    this.clear = button("Clear", () => view.change(() => selected.clear()));
    const all = button("Select all", () => this.select(view.state?.id ?? []));
    this.mode.append(
      this.modeText,
      button("Cancel (Esc)", () => this.leave()),
    );
    const uninform = button("Uninform", () => this.uninformSelected());
    const ids = el("input", {
      type: "text",
      inputmode: "numeric",
      pattern: "[0-9 ,]*",
      title: "numbers, with commas between them",
      autocomplete: "off",
    });
    const select = rowForm(
      async () => this.select(ids.value.split(/[ ,]+/).filter(Boolean).map(Number)),
      el("label", {}, el("span", {}, "ids"), ids),
      el("button", {}, "Select"),
    );
    this.fields = el(
      "fieldset",
      {},
      el("legend", { class: "hidden" }, "inform"),
      rowForm(
        () => this.inform(((numberIn(this.direction.input) ?? 0) * Math.PI) / 180),
        this.direction.label,
        this.weight.label,
        el("button", { class: "primary" }, "Inform"),
      ),
      el("p", { class: "buttons" }, this.drag, uninform),
    );
    this.element = el(
      "div",
      { class: "steering" },
      this.selection,
      el("p", { class: "buttons" }, this.lasso, all, this.clear),
      select,
      this.fields,
      this.mode,
    );
    this.show();
  }

  enter(mode: Mode): void {
    this.view.mode = this.view.mode === mode ? "look" : mode;
    this.view.canvas.focus();
  }

  show(): void {
    const { mode } = this.view;
    const ids = this.ids();
    const named = ids.length > 12 ? `${ids.slice(0, 12).join(", ")}, …` : ids.join(", ");
    setText(
      this.selection,
      ids.length === 0
        ? "No individual is selected: click bodies, or draw a lasso around them."
        : `${plural(ids.length, "individual")} selected: ${named}`,
    );
    this.fields.disabled = !this.session.mayCommand || ids.length === 0;
    this.clear.disabled = ids.length === 0;
    this.element.dataset.mode = mode;
    this.mode.hidden = mode === "look";
    setText(this.modeText, MODES[mode]);
    this.lasso.setAttribute("aria-pressed", String(mode === "lasso"));
    this.drag.setAttribute("aria-pressed", String(mode === "direct"));
  }

  /** Informs the selected individuals; the direction in radians. */
  async inform(direction: number): Promise<void> {
    this.leave();
    this.direction.input.value = degrees(direction).toFixed(1);
    const weight = numberIn(this.weight.input);
    const preference = { direction, ...(weight === undefined ? {} : { weight }) };
    await inform(this.swarm, this.session, this.ids(), preference);
  }

  /** A command ends the lasso or direction mode: the next drag pans. */
  private leave(): void {
    if (this.view.mode !== "look") {
      this.view.mode = "look";
    }
  }

  private async uninformSelected(): Promise<void> {
    this.leave();
    const ids = this.ids();
    const text = `${plural(ids.length, "individual")} uninformed`;
    await attempt(() => command(this.swarm, "uninform", { select: { ids } }), text);
  }

  /** Selects those of the individuals that exist, without a pointer. */
  private select(ids: ArrayLike<number>): void {
    const wanted = new Set(Array.from(ids));
    const { selected, state } = this.view;
    this.view.change(() => {
      selected.clear();
      for (const id of state?.id ?? []) {
        if (wanted.has(id)) {
          selected.add(id);
        }
      }
    });
  }

  private ids(): number[] {
    return [...this.view.selected].sort((a, b) => a - b);
  }
}
