/**
 * The button that executes a swarm's commands again in the browser, and compares the hash of the last
 * state with the daemon's.
 */
import { Runner } from "../engine/runner.ts";
import { button, el, setText } from "../ui/dom.ts";
import { grouped, inSteps, seconds } from "../ui/format.ts";
import { RequestError } from "../wire/http.ts";
import { isModuleServed, type Module, readModule } from "../wire/module.ts";
import { type Claim, requestClaim } from "./claims.ts";

/** The digits of a hash that are shown first. */
const DIGITS = 8;

const PROVES =
  "This browser executes the swarm's commands again and compares the hash of the last state. Equal " +
  "hashes show that these commands give this state on this computer, too. The engine comes from the same " +
  "daemon: against a daemon that lies it proves nothing, unless its SHA-256 is that of a release.";

/** Where the hash of a module comes from, and whether the module is that of a release. */
function originOf({ sha256, isComputed, released }: Module): string {
  const told = isComputed ? "" : "according to the daemon";
  const release =
    released &&
    (released === sha256 ? "that of the release" : `not that of the release, ${released}`);
  const notes = [told, release].filter(Boolean).join("; ");
  return notes && `(${notes})`;
}

type Verdict = "equal" | "different" | "none";

export class Verify {
  readonly button = button("Verify in your browser", () => this.start());
  readonly element: HTMLElement;
  private readonly status = el("p", { role: "status" });
  private readonly bar = el("progress", { max: "1", "aria-label": "part of the steps" });
  private readonly rest = el("span", { class: "soft" });
  private readonly cancel = button("Cancel", () => this.stop("cancelled"));
  private readonly running = el("p", { class: "buttons" }, this.bar, this.rest, this.cancel);
  private readonly hashes = el("dl", { class: "hashes" });
  private runner: Runner | null = null;
  /** The number of verifications begun, by which one that was cancelled knows it. */
  private begun = 0;

  constructor(private readonly swarm: string) {
    this.button.title = "Executes the swarm's commands again, in this browser";
    this.element = el(
      "div",
      { class: "verify", hidden: true },
      this.status,
      this.running,
      this.hashes,
      el("p", { class: "soft" }, PROVES),
    );
    this.button.hidden = true;
    void isModuleServed().then((is) => {
      this.button.hidden = !is;
    });
  }

  end(): void {
    this.begun += 1;
    this.runner?.end();
    this.runner = null;
  }

  private async start(): Promise<void> {
    this.end();
    const { begun } = this;
    this.element.hidden = false;
    this.running.hidden = false;
    this.bar.removeAttribute("value");
    this.hashes.replaceChildren();
    this.show("requesting the commands and the engine …", "none");
    setText(this.rest, "");
    this.button.disabled = true;
    try {
      const waits = (reason: string) => {
        if (begun === this.begun) {
          this.show(`from a snapshot on, since ${reason}. Some seconds of the swarm …`, "none");
        }
      };
      const [claim, module] = await Promise.all([requestClaim(this.swarm, waits), readModule()]);
      if (begun === this.begun) {
        this.run(claim, module);
      }
    } catch (error) {
      if (begun === this.begun) {
        const isGone = error instanceof RequestError && error.code === "not_found";
        const reason = error instanceof Error ? error.message : String(error);
        this.stop(`not verified: ${isGone ? "the daemon has this swarm no longer" : reason}`);
      }
    }
  }

  private run(claim: Claim, module: Module): void {
    const { bytes, sha256 } = module;
    if (sha256) {
      this.put("SHA-256 of the engine", sha256, originOf(module));
    } else {
      this.put("SHA-256 of the engine", "this browser cannot compute it on a page without TLS");
    }
    const worker = new Worker(new URL("../engine/worker.ts", import.meta.url), { type: "module" });
    const runner = new Runner(
      worker,
      { ...claim.task, module: bytes },
      {
        progress: () => {
          if (claim.from === null && runner.steps > claim.steps) {
            this.stop(
              `not verified: commands at the present step ${grouped(claim.steps)} are a part of the ` +
                "state, but not of a run that ends there. Step the swarm once, then verify it.",
            );
            return;
          }
          this.bar.value = runner.share;
          this.show(`executing step ${grouped(runner.step)} of ${grouped(claim.steps)}`, "none");
          setText(this.rest, seconds(runner.remaining));
        },
        finished: ({ step, state_hash, fault }) => {
          this.put("hash in this browser", state_hash);
          this.put("hash of the daemon", claim.state_hash);
          this.compare(claim, step, state_hash, fault);
        },
        failed: ({ message }) => this.stop(`not verified: ${message}`),
      },
    );
    this.runner = runner;
  }

  private compare(claim: Claim, step: number, state_hash: string, fault: string | null): void {
    const [at, short] = [grouped(step), `${state_hash.slice(0, DIGITS)}…`];
    if (step === claim.steps && state_hash === claim.state_hash) {
      const which =
        claim.from === null
          ? `after ${inSteps(step)}`
          : `from step ${grouped(claim.from)} to step ${at}`;
      this.stop(`equal ${which}: ${short}`, "equal");
    } else if (step < claim.steps) {
      const why = fault ?? "the run ended";
      this.stop(
        `different: step ${at} of ${grouped(claim.steps)} is the last: ${why}`,
        "different",
      );
    } else {
      const where = claim.from === null ? "the end" : `step ${at}`;
      this.stop(`different at ${where}: jostle verify ${this.swarm} names the step`, "different");
    }
  }

  /** Ends what is in progress, and says how. */
  private stop(text: string, verdict: Verdict = "none"): void {
    this.end();
    this.running.hidden = true;
    this.button.disabled = false;
    this.show(text, verdict);
    this.element.scrollIntoView({ block: "nearest" });
  }

  private show(text: string, verdict: Verdict): void {
    setText(this.status, text);
    this.status.dataset.verdict = verdict;
  }

  private put(name: string, digits: string, note = ""): void {
    const small = note ? el("small", {}, ` ${note}`) : null;
    this.hashes.append(
      el("div", {}, el("dt", {}, name, small), el("dd", {}, el("code", {}, digits))),
    );
  }
}
