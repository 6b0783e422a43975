/** The form that changes a parameter of the run: the reader's variant. */

import type { FullSpec } from "../engine/engine.ts";
import { button, el, setText } from "../ui/dom.ts";
import { form, numberField, numberIn } from "../ui/field.ts";
import { grouped } from "../ui/format.ts";
import type { Content } from "./file.ts";
import { mayVary, VARIED, type Varied, valueIn, withValue } from "./variant.ts";

const UNITS: Partial<Record<Varied, string>> = { duration: "time units" };
const ABOUT: Record<Varied, string> = {
  seed: "of all random draws",
  duration: "of the run",
  n: "the number of individuals",
  pi1: "length over width of a body",
  pi2: "weight of informed individuals",
  pi3: "body size over turning radius",
  pi4: "translational over rotational drag",
  noise: "intensity of the noise on turning",
};

export interface ParametersEvents {
  /** Runs the experiment with this text. */
  vary(toml: string, change: string): void;
  /** Shows the published run again. */
  back(): void;
}

export class Parameters {
  readonly element: HTMLElement;
  private readonly status = el("p", { role: "status" });
  private readonly back = button("Back to the published run", () => {
    this.back.hidden = true;
    this.say("");
    this.form.reset();
    this.events.back();
  });
  private readonly others = el("p", { class: "soft" });
  private readonly form: HTMLFormElement;
  private fields: { name: Varied; input: HTMLInputElement; was: number | null }[] = [];

  constructor(
    private readonly content: Content,
    private readonly events: ParametersEvents,
  ) {
    this.back.hidden = true;
    this.form = form(
      "grid-form",
      async () => this.submit(),
      el("button", { type: "submit", class: "primary" }, "Run your variant"),
    );
    this.form.hidden = true;
    this.element = el(
      "div",
      { class: "controls" },
      this.form,
      this.others,
      this.status,
      el("p", {}, this.back),
    );
  }

  /** Offers the parameters of a run with this spec. */
  offer(spec: FullSpec): void {
    const { files } = this.content;
    const offered = files ? VARIED.filter((name) => mayVary(files, name)) : [];
    const labels: HTMLElement[] = [];
    this.fields = offered.map((name) => {
      const was = name === "duration" ? valueIn(files!.toml, name) : spec[name];
      const isWhole = name === "n" || name === "seed";
      const { label, input } = numberField({
        label: name,
        value: was === null ? "" : String(was),
        unit: UNITS[name] ?? "",
        min: name === "n" || name === "pi1" ? "1" : "0",
        step: isWhole ? "1" : "any",
      });
      label.title = ABOUT[name];
      labels.push(label);
      return { name, input, was };
    });
    this.form.prepend(...labels);
    const others = VARIED.filter((name) => !offered.includes(name));
    setText(this.others, others.length > 0 ? `set by the experiment: ${others.join(", ")}` : "");
    this.form.hidden = false;
  }

  /** What is said about the variant. */
  say(text: string): void {
    setText(this.status, text);
  }

  progress(step: number, steps: number): void {
    this.say(`your variant: step ${grouped(step)} of ${grouped(steps)}`);
  }

  private submit(): void {
    const changes = this.fields.flatMap(({ name, input, was }) => {
      const value = numberIn(input);
      return value === undefined || value === was ? [] : [{ name, value }];
    });
    if (changes.length === 0) {
      this.say("change a value first");
      return;
    }
    let toml = this.content.files!.toml;
    for (const { name, value } of changes) {
      toml = withValue(toml, name, value);
    }
    this.back.hidden = false;
    this.events.vary(toml, changes.map(({ name, value }) => `${name} = ${value}`).join(", "));
  }
}
