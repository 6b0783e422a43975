/** Makes elements. Text is always text: nothing that the daemon says becomes markup. */

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

export function svg(tag: string, props: Record<string, string>, ...children: Node[]): SVGElement {
  const element = document.createElementNS(SVG, tag) as SVGElement;
  assign(element, props);
  element.append(...children);
  return element;
}

/** `onclick` and the like listen; `true` is an attribute without a value. */
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

/** Changes a text only if it is another one, so that nothing is laid out anew for nothing. */
export function say(node: Element, text: string): void {
  if (node.textContent !== text) {
    node.textContent = text;
  }
}
