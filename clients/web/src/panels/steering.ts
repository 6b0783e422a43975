/** Who is selected, and what they are told: a direction of their own, or none. */
import { attempt } from "../parts/announce.ts";
import { el, say } from "../parts/dom.ts";
import { form, numberField, numberIn } from "../parts/field.ts";
import { degrees, plural } from "../parts/format.ts";
import type { Session } from "../parts/session.ts";
import type { Stage } from "../stage/stage.ts";
import { command } from "../wire/http.ts";
import { inform } from "./inform.ts";

export class Steering {
  readonly element: HTMLElement;
  private readonly who = el("p", { class: "who", "aria-live": "polite" });
  private readonly direction = numberField({
    label: "direction",
    unit: "(°)",
    value: "0",
    required: true,
  });
  private readonly weight = numberField({ label: "weight", min: "0", placeholder: "pi2" });
  private readonly fields: HTMLFieldSetElement;
  private readonly clear = el("button", { type: "button" }, "Nobody");
  private readonly all = el("button", { type: "button" }, "Everybody");
  private readonly lasso = el("button", { type: "button" }, "Lasso");
  private readonly drag = el("button", { type: "button" }, "Drag a direction");
  private readonly uninform = el("button", { type: "button" }, "Uninform");

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
    private readonly stage: Stage,
  ) {
    const { selected } = stage;
    this.clear.addEventListener("click", () => stage.change(() => selected.clear()));
    this.all.addEventListener("click", () =>
      stage.change(() => {
        for (const id of stage.state?.id ?? []) {
          selected.add(id);
        }
      }),
    );
    this.lasso.addEventListener("click", () => this.enter("lasso"));
    this.drag.addEventListener("click", () => this.enter("direct"));
    this.uninform.addEventListener("click", () => void this.takeAway());
    const ids = el("input", {
      type: "text",
      inputmode: "numeric",
      pattern: "[0-9 ,]*",
      title: "numbers, with commas between them",
      autocomplete: "off",
    });
    const select = form(
      { class: "row" },
      async () => this.select(ids.value),
      el("label", {}, el("span", {}, "ids"), ids),
      el("button", {}, "Select"),
    );
    this.fields = el(
      "fieldset",
      {},
      el("legend", { class: "hidden" }, "inform"),
      form(
        { class: "row" },
        () => this.inform(((numberIn(this.direction.input) ?? 0) * Math.PI) / 180),
        this.direction.label,
        this.weight.label,
        el("button", { class: "primary" }, "Inform"),
      ),
      el("p", { class: "buttons" }, this.drag, this.uninform),
    );
    this.element = el(
      "div",
      { class: "steering" },
      this.who,
      el("p", { class: "buttons" }, this.lasso, this.all, this.clear),
      select,
      this.fields,
    );
    this.show();
  }

  enter(mode: "look" | "lasso" | "direct"): void {
    this.stage.mode = this.stage.mode === mode ? "look" : mode;
    this.stage.canvas.focus();
  }

  show(): void {
    const { selected, mode } = this.stage;
    const ids = [...selected].sort((a, b) => a - b);
    const named = ids.length > 12 ? `${ids.slice(0, 12).join(", ")}, …` : ids.join(", ");
    say(
      this.who,
      ids.length === 0
        ? "Nobody is selected: click bodies, or draw a lasso around some."
        : `${plural(ids.length, "individual")} selected: ${named}`,
    );
    this.fields.disabled = !this.session.mayCommand || ids.length === 0;
    this.clear.disabled = ids.length === 0;
    this.lasso.setAttribute("aria-pressed", String(mode === "lasso"));
    this.drag.setAttribute("aria-pressed", String(mode === "direct"));
  }

  /** Informs the selected; the direction in radians. */
  async inform(direction: number): Promise<void> {
    this.leave();
    this.direction.input.value = degrees(direction).toFixed(1);
    const weight = numberIn(this.weight.input);
    const preference = { direction, ...(weight === undefined ? {} : { weight }) };
    await inform(this.swarm, this.session, this.ids(), preference);
  }

  /** A command ends the lasso or direction mode: the next drag pans. */
  private leave(): void {
    if (this.stage.mode !== "look") {
      this.stage.mode = "look";
    }
  }

  private async takeAway(): Promise<void> {
    this.leave();
    const ids = this.ids();
    const said = `${plural(ids.length, "individual")} uninformed`;
    await attempt(() => command(this.swarm, "uninform", { select: { ids } }), said);
  }

  /** Selects by number, for those who do not point. */
  private select(text: string): void {
    const there = new Set(this.stage.state?.id);
    const { selected } = this.stage;
    this.stage.change(() => {
      selected.clear();
      for (const id of text.split(/[ ,]+/).filter(Boolean).map(Number)) {
        if (there.has(id)) {
          selected.add(id);
        }
      }
    });
  }

  private ids(): number[] {
    return [...this.stage.selected].sort((a, b) => a - b);
  }
}
