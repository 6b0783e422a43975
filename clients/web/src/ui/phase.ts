/** A phase as a symbol and a word. */
import type { Phase } from "../wire/messages.ts";
import { el, setText } from "./dom.ts";

const SIGNS: Record<Phase, string> = { running: "▶", paused: "❚❚", faulted: "⚠" };

export class PhaseChip {
  private readonly sign = el("span", { "aria-hidden": "true", class: "sign" });
  private readonly word = el("span");
  readonly element = el("span", { class: "phase" }, this.sign, this.word);

  show(phase: Phase): void {
    if (this.element.dataset.phase !== phase) {
      this.element.dataset.phase = phase;
      setText(this.sign, SIGNS[phase]);
      setText(this.word, phase);
    }
  }
}
