/** Buttons beside the picture, each with its key. */
import { el } from "../parts/dom.ts";
import { icon, type Sign } from "../parts/icons.ts";
import type { Shows } from "../stage/painting.ts";
import type { Stage } from "../stage/stage.ts";

const LAYERS: [keyof Shows, string, string, Sign][] = [
  ["contacts", "c", "Contacts", "contacts"],
  ["clusters", "k", "Clusters", "clusters"],
  ["trails", "t", "Trails", "trails"],
  ["preferences", "p", "Preference of everybody", "preferences"],
];

/** Part of the picture's width that an arrow key pans by. */
const PAN = 0.08;
const ZOOM = 1.25;

export class Toolbar {
  readonly element: HTMLElement;
  private readonly pressed: { button: HTMLButtonElement; is: () => boolean }[] = [];

  constructor(
    private readonly stage: Stage,
    lasso: () => void,
  ) {
    const { shows } = stage;
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
        () => stage.camera.following,
      ),
      ...LAYERS.map(([name, key, title, sign]) =>
        this.button(
          title,
          key,
          sign,
          () => this.toggle(name),
          () => shows[name],
        ),
      ),
      this.button("Lasso", "l", "lasso", lasso, () => stage.mode === "lasso"),
      this.button("Zoom in", "+", "more", () => this.zoom(ZOOM)),
      this.button("Zoom out", "−", "less", () => this.zoom(1 / ZOOM)),
    );
    // A click leaves the focus where it is, so that space goes on meaning run and pause.
    this.element.addEventListener("mousedown", (event) => event.preventDefault());
    this.show();
  }

  show(): void {
    for (const { button, is } of this.pressed) {
      button.setAttribute("aria-pressed", String(is()));
    }
  }

  follow(): void {
    this.stage.change(() => this.stage.camera.follow());
  }

  toggle(name: keyof Shows): void {
    this.stage.change(() => {
      this.stage.shows[name] = !this.stage.shows[name];
    });
  }

  zoom(factor: number): void {
    const { camera } = this.stage;
    this.stage.change(() => camera.zoomAt(camera.width / 2, camera.height / 2, factor));
  }

  /** What a key means for the picture; whether it means anything. */
  key(key: string): boolean {
    const layer = LAYERS.find(([, it]) => it === key);
    const { camera } = this.stage;
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
      this.stage.change(() => camera.pan(...pan));
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
