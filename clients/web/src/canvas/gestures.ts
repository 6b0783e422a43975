/** Translates pointer, wheel and pinch events on the picture into actions. */

export type Mode = "look" | "lasso" | "direct";

export interface Actions {
  pan(right: number, down: number): void;
  zoom(left: number, top: number, factor: number): void;
  click(left: number, top: number, adds: boolean): void;
  /** The points of a lasso in pixels, x, y, …; `done` when the pointer is released. */
  lasso(line: number[], done: boolean, adds: boolean): void;
  /** A direction that is being dragged. */
  direct(from: [number, number], to: [number, number], done: boolean): void;
  /** The current gesture is cancelled. */
  cancel(): void;
}

/** A pointer that moves less than this clicks. */
const CLICK_PX = 5;

interface Drag {
  pointer: number;
  from: [number, number];
  at: [number, number];
  line: number[];
  moved: boolean;
}

export class Gestures {
  mode: Mode = "look";
  private readonly pointers = new Map<number, [number, number]>();
  private drag: Drag | null = null;
  private pinched = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly actions: Actions,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.lose(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  /** Cancels the current drag. */
  abandon(): void {
    this.drag = null;
    this.actions.cancel();
  }

  private place(event: MouseEvent): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  private down(event: PointerEvent): void {
    if (event.button !== 0) {
      return;
    }
    this.canvas.setPointerCapture(event.pointerId);
    const at = this.place(event);
    this.pointers.set(event.pointerId, at);
    if (this.pointers.size > 1) {
      // A second finger starts a pinch and cancels the drag of the first.
      this.abandon();
      this.pinched = this.spread();
      return;
    }
    this.drag = { pointer: event.pointerId, from: at, at, line: [...at], moved: false };
  }

  private move(event: PointerEvent): void {
    if (!this.pointers.has(event.pointerId)) {
      return;
    }
    const at = this.place(event);
    this.pointers.set(event.pointerId, at);
    if (this.pointers.size === 2) {
      const spread = this.spread();
      const [x, y] = this.middle();
      if (this.pinched > 0 && spread > 0) {
        this.actions.zoom(x, y, spread / this.pinched);
      }
      this.pinched = spread;
      return;
    }
    const { drag } = this;
    if (!drag || drag.pointer !== event.pointerId) {
      return;
    }
    const far = Math.hypot(at[0] - drag.from[0], at[1] - drag.from[1]);
    if (!drag.moved && far < CLICK_PX) {
      return;
    }
    const before = drag.moved ? drag.at : drag.from;
    drag.moved = true;
    drag.at = at;
    if (this.mode === "look") {
      this.actions.pan(at[0] - before[0], at[1] - before[1]);
    } else if (this.mode === "lasso") {
      drag.line.push(...at);
      this.actions.lasso(drag.line, false, event.shiftKey);
    } else {
      this.actions.direct(drag.from, at, false);
    }
  }

  private up(event: PointerEvent): void {
    const { drag } = this;
    this.pointers.delete(event.pointerId);
    this.drag = null;
    if (!drag || drag.pointer !== event.pointerId) {
      return;
    }
    const adds = event.shiftKey;
    if (!drag.moved) {
      this.actions.click(...drag.from, adds);
    } else if (this.mode === "lasso") {
      this.actions.lasso(drag.line, true, adds);
    } else if (this.mode === "direct") {
      this.actions.direct(drag.from, drag.at, true);
    }
  }

  private lose(event: PointerEvent): void {
    this.pointers.delete(event.pointerId);
    this.abandon();
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    const turn = Math.max(-240, Math.min(240, event.deltaY * lines));
    const speed = event.ctrlKey ? 0.01 : 0.0016;
    this.actions.zoom(...this.place(event), Math.exp(-turn * speed));
  }

  private spread(): number {
    const [a, b] = [...this.pointers.values()];
    return a && b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 0;
  }

  private middle(): [number, number] {
    const [a, b] = [...this.pointers.values()];
    return a && b ? [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] : [0, 0];
  }
}
