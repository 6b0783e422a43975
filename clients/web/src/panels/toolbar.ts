/** The buttons on the picture and their keys. */

import type { Layers } from "../canvas/painting.ts";
import type { View } from "../canvas/view.ts";
import { el } from "../ui/dom.ts";
import { icon, type Sign } from "../ui/icons.ts";

const LAYERS: [keyof Layers, string, string, Sign][] = [
  ["headings", "h", "Colour by heading", "headings"],
  ["contacts", "c", "Contacts", "contacts"],
  ["clusters", "k", "Clusters", "clusters"],
  ["trails", "t", "Trails", "trails"],
  ["preferences", "p", "Preferences", "preferences"],
];

/** The share of the picture's shorter side by which an arrow key pans. */
const PAN = 0.08;
const ZOOM = 1.25;

export class Toolbar {
  readonly element: HTMLElement;
  private readonly pressed: { button: HTMLButtonElement; is: () => boolean }[] = [];

  /** Of the layers only those are switched that are named. Without `lasso` there is no such tool. */
  constructor(
    private readonly view: Pick<View, "layers" | "camera" | "change" | "mode">,
    private readonly names: readonly (keyof Layers)[],
    lasso?: () => void,
  ) {
    const { layers } = view;
    this.element = el(
      "div",
      {
        class: "toolbar",
        role: "toolbar",
        "aria-label": "picture",
        "aria-orientation": "vertical",
      },
      this.button(
        "Follow",
        "f",
        "follow",
        () => this.follow(),
        () => view.camera.following,
      ),
      ...this.offered.map(([name, key, title, sign]) =>
        this.button(
          title,
          key,
          sign,
          () => this.toggle(name),
          () => layers[name],
        ),
      ),
      ...(lasso ? [this.button("Lasso", "l", "lasso", lasso, () => view.mode === "lasso")] : []),
      this.button("Zoom in", "+", "more", () => this.zoom(ZOOM)),
      this.button("Zoom out", "−", "less", () => this.zoom(1 / ZOOM)),
    );
    // A click must not move the focus: space runs and pauses.
    this.element.addEventListener("mousedown", (event) => event.preventDefault());
    this.show();
  }

  show(): void {
    for (const { button, is } of this.pressed) {
      button.setAttribute("aria-pressed", String(is()));
    }
  }

  follow(): void {
    this.view.change(() => this.view.camera.follow());
  }

  toggle(name: keyof Layers): void {
    this.view.change(() => {
      this.view.layers[name] = !this.view.layers[name];
    });
  }

  zoom(factor: number): void {
    const { camera } = this.view;
    this.view.change(() => camera.zoomAt(camera.width / 2, camera.height / 2, factor));
  }

  /** Handles a key; returns whether it did. */
  key(key: string): boolean {
    const layer = this.offered.find(([, it]) => it === key);
    const { camera } = this.view;
    const far = PAN * Math.min(camera.width, camera.height);
    const pans: Record<string, [number, number]> = {
      ArrowLeft: [far, 0],
      ArrowRight: [-far, 0],
      ArrowUp: [0, far],
      ArrowDown: [0, -far],
    };
    const pan = pans[key];
    if (layer) {
      this.toggle(layer[0]);
    } else if (pan) {
      this.view.change(() => camera.pan(...pan));
    } else if (key === "f") {
      this.follow();
    } else if (key === "+" || key === "=") {
      this.zoom(ZOOM);
    } else if (key === "-" || key === "−") {
      this.zoom(1 / ZOOM);
    } else {
      return false;
    }
    return true;
  }

  private get offered() {
    return LAYERS.filter(([name]) => this.names.includes(name));
  }

  private button(
    title: string,
    key: string,
    sign: Sign,
    act: () => void,
    is?: () => boolean,
  ): HTMLButtonElement {
    const label = `${title} (${key})`;
    const props = { type: "button", title: label, "aria-label": title, "aria-keyshortcuts": key };
    const button = el("button", props, icon(sign));
    button.addEventListener("click", act);
    if (is) {
      this.pressed.push({ button, is });
    }
    return button;
  }
}
