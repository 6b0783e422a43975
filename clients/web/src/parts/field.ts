/** Fields of forms. */
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

/** A number with its label and unit; the browser checks its range before it is sent. */
export function numberField(it: NumberField): { label: HTMLLabelElement; input: HTMLInputElement } {
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

export function nameField(
  label: string,
  value: string,
): { label: HTMLLabelElement; input: HTMLInputElement } {
  const input = el("input", {
    type: "text",
    value,
    required: true,
    pattern: "[a-z0-9][a-z0-9_\\-]{0,63}",
    title: "lower case letters, digits, - and _; at most 64",
    autocomplete: "off",
    autocapitalize: "off",
    spellcheck: "false",
  });
  return { label: el("label", {}, el("span", {}, label), input), input };
}

/** A line of text of at most `longest` UTF-16 code units. */
export function textField(
  label: string,
  longest: number,
): { label: HTMLLabelElement; input: HTMLInputElement } {
  const input = el("input", {
    type: "text",
    required: true,
    maxlength: String(longest),
    autocomplete: "off",
  });
  return { label: el("label", {}, el("span", {}, label), input), input };
}

/** What is in a field: a number, or nothing if it is empty. */
export function numberIn(input: HTMLInputElement): number | undefined {
  return input.value === "" ? undefined : input.valueAsNumber;
}

/** A form that does something in place of being sent away. */
export function form(
  props: Record<string, string>,
  submit: () => Promise<unknown> | undefined,
  ...children: (Node | string)[]
): HTMLFormElement {
  const element = el("form", { ...props }, ...children);
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
