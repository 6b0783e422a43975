/** Creates elements. Text is only inserted as text nodes: no daemon reply is parsed as markup. */

type Child = Node | string | null | undefined | false;

type Props = Record<string, string | boolean | null | undefined | ((event: Event) => void)>;

const SVG = "http://www.w3.org/2000/svg";

export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  assign(element, props);
  element.append(...children.filter((child): child is Node | string => Boolean(child)));
  return element;
}

/** A button that calls `act` when it is pressed. */
export function button(text: string, act: () => unknown, kind?: string): HTMLButtonElement {
  return el("button", { type: "button", class: kind, onclick: () => void act() }, text);
}

export function svg(tag: string, props: Record<string, string>, ...children: Node[]): SVGElement {
  const element = document.createElementNS(SVG, tag) as SVGElement;
  assign(element, props);
  element.append(...children);
  return element;
}

/** Functions become event listeners (`onclick`); `true` becomes an attribute without a value. */
function assign(element: Element, props: Props): void {
  for (const [name, value] of Object.entries(props)) {
    if (typeof value === "function") {
      element.addEventListener(name.slice(2), value);
    } else if (value === true) {
      element.setAttribute(name, "");
    } else if (typeof value === "string") {
      element.setAttribute(name, value);
    }
  }
}

/** Calls every function. */
export function callAll(functions: Iterable<() => void>): void {
  for (const it of [...functions]) {
    it();
  }
}

/** Sets a text only if it differs: an equal text would still cause a layout. */
export function setText(node: Element, text: string): void {
  if (node.textContent !== text) {
    node.textContent = text;
  }
}
