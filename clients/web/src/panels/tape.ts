/** Where a replay is in its recording, and a way to go elsewhere. Hidden for swarms that live. */
import { attempt } from "../parts/announce.ts";
import { el, say } from "../parts/dom.ts";
import { time } from "../parts/format.ts";
import type { Session } from "../parts/session.ts";
import { command, get } from "../wire/http.ts";
import type { Replay } from "../wire/messages.ts";

/** How often a replay that runs is asked where it is. */
const ASK_MS = 500;

const PARTS = 1000;

export class Tape {
  readonly element: HTMLElement;
  private readonly slider = el("input", {
    type: "range",
    min: "0",
    max: String(PARTS),
    step: "any",
    "aria-label": "place in the recording",
  });
  private readonly place = el("output", { class: "soft" });
  private readonly of = el("span", {});
  private readonly timer: ReturnType<typeof setInterval>;
  private is = false;
  private running = false;
  private held = false;
  private duration = 0;

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
  ) {
    this.element = el("div", { class: "tape", hidden: true }, this.of, this.slider, this.place);
    this.slider.addEventListener("input", () => {
      this.held = true;
      this.say(Number(this.slider.value) / PARTS);
    });
    this.slider.addEventListener("change", () => void this.seek());
    this.timer = setInterval(() => {
      if (this.is && this.running && !this.held) {
        void this.ask();
      }
    }, ASK_MS);
    this.allow();
  }

  /** What the list says of it. */
  show(row: { replay?: boolean; phase: string } | undefined): void {
    const was = this.running;
    this.is = row?.replay ?? false;
    this.running = row?.phase === "running";
    this.element.hidden = !this.is;
    if (this.is && (was || this.running || this.duration === 0)) {
      void this.ask();
    }
  }

  allow(): void {
    this.slider.disabled = !this.session.mayCommand;
  }

  /** It went elsewhere. */
  async ask(): Promise<void> {
    if (!this.is) {
      return;
    }
    try {
      const { result } = await get<{ replay: Replay | null }>(this.swarm, "status");
      if (result.replay && !this.held) {
        const { of, position, duration } = result.replay;
        this.duration = duration;
        say(this.of, `replay of ${of}`);
        const share = duration > 0 ? position / duration : 1;
        this.slider.value = String(PARTS * share);
        this.say(share);
      }
    } catch {
      // It is gone, or the daemon away: the picture says so.
    }
  }

  end(): void {
    clearInterval(this.timer);
  }

  private say(share: number): void {
    const text = `${time(share * this.duration)} of ${time(this.duration)}`;
    say(this.place, text);
    this.slider.setAttribute("aria-valuetext", text);
  }

  private async seek(): Promise<void> {
    const fraction = Number(this.slider.value) / PARTS;
    await attempt(() => command(this.swarm, "seek", { fraction }));
    this.held = false;
    await this.ask();
  }
}
