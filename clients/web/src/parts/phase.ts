/** A phase as a sign and a word. */
import type { Phase } from "../wire/messages.ts";
import { el, say } from "./dom.ts";

const SIGNS: Record<Phase, string> = { running: "▶", paused: "❚❚", faulted: "⚠" };

export class PhaseChip {
  private readonly sign = el("span", { "aria-hidden": "true", class: "sign" });
  private readonly word = el("span");
  readonly element = el("span", { class: "phase" }, this.sign, this.word);

  show(phase: Phase): void {
    if (this.element.dataset.phase !== phase) {
      this.element.dataset.phase = phase;
      say(this.sign, SIGNS[phase]);
      say(this.word, phase);
    }
  }
}
