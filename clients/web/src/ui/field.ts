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
    await submit();
    busy = false;
  });
  return element;
}
