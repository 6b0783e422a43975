/** Form fields. */
import { el } from "./dom.ts";

export interface NumberField {
  label: string;
  value?: string;
  unit?: string;
  min?: string;
  max?: string;
  step?: string;
  placeholder?: string;
  required?: boolean;
}

export interface Field {
  label: HTMLLabelElement;
  input: HTMLInputElement;
}

/** A number with its label and unit; the browser validates its range. */
export function numberField(it: NumberField): Field {
  const input = el("input", {
    type: "number",
    inputmode: "decimal",
    value: it.value,
    min: it.min,
    max: it.max,
    step: it.step ?? "any",
    placeholder: it.placeholder,
    required: it.required ?? false,
  });
  const unit = it.unit ? el("small", {}, ` ${it.unit}`) : null;
  return { label: el("label", {}, el("span", {}, it.label, unit), input), input };
}

/** A whole number of at least 1. */
export function countField(label: string): Field {
  return numberField({ label, value: "1", min: "1", step: "1", required: true });
}

export function nameField(label: string, value: string): Field {
  return textField(label, {
    value,
    pattern: "[a-z0-9][a-z0-9_\\-]{0,63}",
    title: "lower case letters, digits, - and _; at most 64",
    autocapitalize: "off",
    spellcheck: "false",
  });
}

/** A line of text, with further attributes. */
export function textField(label: string, props: Record<string, string>): Field {
  const input = el("input", { type: "text", required: true, autocomplete: "off", ...props });
  return { label: el("label", {}, el("span", {}, label), input), input };
}

/** A choice between options, which are their own labels. */
export function selectField(
  label: string,
  options: readonly string[],
): { label: HTMLLabelElement; select: HTMLSelectElement } {
  const select = el("select", {}, ...options.map((value) => el("option", { value }, value)));
  return { label: el("label", {}, el("span", {}, label), select), select };
}

/** The number in a field; undefined if it is empty. */
export function numberIn(input: HTMLInputElement): number | undefined {
  return input.value === "" ? undefined : input.valueAsNumber;
}

/**
 * Lets the fields of a form follow a value of the daemon, except while another one is typed in them.
 * What is typed stays until it is sent. If the daemon's value changes meanwhile, or it rejects what was
 * sent, the fields follow again once they have lost the focus.
 */
export class Followed {
  private typed = false;
  private overtaken = false;
  /** Whether the daemon has told another value since what was typed was sent. */
  private told = false;

  /** `fill` puts the daemon's value into the fields. */
  constructor(
    private readonly form: HTMLFormElement,
    private readonly fill: () => void,
  ) {
    form.addEventListener("input", () => {
      this.typed = true;
    });
    form.addEventListener("submit", () => {
      this.told = false;
    });
    form.addEventListener("focusout", ({ relatedTarget }) => {
      if (this.overtaken && !form.contains(relatedTarget as Node | null)) {
        this.follow();
      }
    });
  }

  /** The daemon has replied to what was typed. */
  sent(accepted: boolean): void {
    if (accepted && this.told) {
      // The daemon has told its new value already, or one after it: the reply was slow.
      this.follow();
    } else if (accepted) {
      // The daemon tells its new value next.
      this.typed = false;
      this.overtaken = false;
    } else if (this.form.contains(document.activeElement)) {
      this.overtaken = true;
    } else {
      this.follow();
    }
  }

  /** The daemon has told its value. */
  show(changed: boolean): void {
    this.told ||= changed;
    if (!this.typed) {
      this.fill();
    } else if (changed && this.form.contains(document.activeElement)) {
      this.overtaken = true;
    } else if (changed) {
      this.follow();
    }
  }

  private follow(): void {
    this.typed = false;
    this.overtaken = false;
    this.fill();
  }
}

/** A form in one row, see `form`. */
export function rowForm(
  submit: () => Promise<unknown> | undefined,
  ...children: (Node | string)[]
): HTMLFormElement {
  return form("row", submit, ...children);
}

/** A form that calls `submit` and does not navigate. Submitting again before it returns has no effect. */
export function form(
  kind: string,
  submit: () => Promise<unknown> | undefined,
  ...children: (Node | string)[]
): HTMLFormElement {
  const element = el("form", { class: kind }, ...children);
  let busy = false;
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (busy) {
      return;
    }
    busy = true;
    element.setAttribute("aria-busy", "true");
    await submit();
    busy = false;
    element.removeAttribute("aria-busy");
  });
  return element;
}
