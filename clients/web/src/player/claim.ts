/** The panel that says whether the run has the hash that was published. */
import { el, setText } from "../ui/dom.ts";
import { grouped, inSteps, seconds } from "../ui/format.ts";
import type { Claim } from "./file.ts";

/** The end of a run in this browser. */
export interface End {
  step: number;
  state_hash: string;
  fault: string | null;
}

export function isEqual(claim: Claim, end: End): boolean {
  return (
    end.step === claim.steps &&
    end.state_hash === claim.state_hash &&
    (end.fault ?? "") === (claim.fault ?? "")
  );
}

export class ClaimPanel {
  readonly element: HTMLElement;
  /** The verdict, for the head of the page. */
  readonly chip = el("span", { class: "verdict" });
  private readonly aside = el(
    "p",
    { hidden: true },
    "The picture shows your variant. Of the published run:",
  );
  private readonly status = el("p", { class: "verdict", role: "status" });
  private readonly rest = el("p", { class: "soft" });
  private readonly bar = el("progress", { max: "1", "aria-label": "part of the steps" });
  private readonly hashes = el("dl", { class: "hashes" });

  constructor() {
    this.element = el(
      "div",
      { class: "verify" },
      this.aside,
      this.status,
      this.bar,
      this.rest,
      this.hashes,
    );
    this.bar.hidden = true;
  }

  /** Whether the picture shows a variant, about which nothing is claimed. */
  showVariant(is: boolean): void {
    this.aside.hidden = !is;
    this.showChip();
  }

  /** Says something without a verdict. */
  say(text: string, more = ""): void {
    this.put("none", text, more);
  }

  /** Shows the hash that was published. */
  publish(claim: Claim | null): void {
    this.hashes.replaceChildren(...(claim ? hash("published", claim.state_hash) : []));
  }

  /** The run is in progress. */
  progress(step: number, steps: number, remaining: number | null): void {
    this.bar.hidden = false;
    this.bar.value = steps === 0 ? 0 : step / steps;
    setText(this.rest, `step ${grouped(step)} of ${grouped(steps)} ${seconds(remaining)}`.trim());
  }

  /** The published run has ended. */
  compare(claim: Claim, end: End): void {
    const steps = inSteps(end.step);
    this.hashes.replaceChildren(
      ...hash("published", claim.state_hash),
      ...hash("in this browser", end.state_hash),
    );
    if (isEqual(claim, end)) {
      this.put(
        "equal",
        `equal after ${steps}`,
        "This browser has executed the commands in this file, and its last state has the hash that was " +
          "published: every position and heading is the same to the last bit." +
          (end.fault ? ` Both runs ended early: ${end.fault}.` : ""),
      );
    } else if (end.step !== claim.steps || (end.fault ?? "") !== (claim.fault ?? "")) {
      const ended = (step: number, fault?: string | null) =>
        `after ${inSteps(step)}${fault ? ` (${fault})` : ""}`;
      this.put(
        "different",
        `different: the run ended ${ended(end.step, end.fault)}, the published one ` +
          ended(claim.steps, claim.fault),
        "This file does not give the published result.",
      );
    } else {
      this.put(
        "different",
        `different after ${steps}`,
        "The commands in this file do not give the hash that was published: the file was changed, or " +
          "this browser computes otherwise. Compare with jostle check FILE.html.",
      );
    }
  }

  private showChip(): void {
    const isVariant = !this.aside.hidden;
    this.chip.dataset.verdict = isVariant ? "none" : (this.status.dataset.verdict ?? "none");
    setText(this.chip, isVariant ? "your variant: nothing is claimed" : this.status.textContent);
  }

  private put(verdict: string, text: string, more: string): void {
    this.bar.hidden = true;
    this.status.dataset.verdict = verdict;
    setText(this.status, text);
    this.showChip();
    setText(this.rest, more);
  }
}

function hash(name: string, digits: string): Node[] {
  return [el("div", {}, el("dt", {}, name), el("dd", {}, el("code", {}, digits)))];
}
