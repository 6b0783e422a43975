/** The position of a playback, with a slider to seek. Hidden for simulated swarms. */
import { attempt } from "../ui/announce.ts";
import { el, setText } from "../ui/dom.ts";
import { time } from "../ui/format.ts";
import type { Session } from "../ui/session.ts";
import { command, get } from "../wire/http.ts";
import type { Replay } from "../wire/messages.ts";

/** How often the position of a running playback is requested. */
const POLL_MS = 500;

/** Steps of the slider. */
const STEPS = 1000;

export class Playback {
  readonly element: HTMLElement;
  private readonly slider = el("input", {
    type: "range",
    min: "0",
    max: String(STEPS),
    step: "any",
    "aria-label": "position in the recording",
  });
  private readonly place = el("output", { class: "soft" });
  private readonly source = el("span", {});
  private readonly timer: ReturnType<typeof setInterval>;
  private isPlayback = false;
  private running = false;
  /** Whether the slider is moved, or where it is was not sent yet: it does not follow the daemon. */
  private held = false;
  private pressed = false;
  /** The number of positions that are being sent. */
  private seeks = 0;
  /** The number of requests for the position. */
  private reads = 0;
  private readonly ends = new AbortController();
  private duration = 0;

  constructor(
    private readonly swarm: string,
    private readonly session: Session,
  ) {
    this.element = el(
      "div",
      { class: "playback", hidden: true },
      this.source,
      this.slider,
      this.place,
    );
    this.slider.addEventListener("input", () => {
      this.held = true;
      this.showPosition(Number(this.slider.value) / STEPS);
    });
    this.slider.addEventListener("change", () => void this.seek());
    this.slider.addEventListener("pointerdown", () => {
      this.pressed = true;
    });
    for (const end of ["pointerup", "pointercancel"]) {
      const listener = () => {
        this.pressed = false;
        // After its change, of which there is none if it was moved back to where it was.
        setTimeout(() => this.release());
      };
      addEventListener(end, listener, { signal: this.ends.signal });
    }
    this.timer = setInterval(() => {
      if (this.isPlayback && this.running && !this.held) {
        void this.refresh();
      }
    }, POLL_MS);
    this.allow();
  }

  /** Shows the row of the list of swarms. */
  show(row: { replay?: boolean; phase: string } | undefined): void {
    const was = this.running;
    this.isPlayback = row?.replay ?? false;
    this.running = row?.phase === "running";
    this.element.hidden = !this.isPlayback;
    if (this.isPlayback && (was || this.running || this.duration === 0)) {
      void this.refresh();
    }
  }

  allow(): void {
    this.slider.disabled = !this.session.mayCommand;
  }

  /** Requests the position. */
  async refresh(): Promise<void> {
    if (!this.isPlayback) {
      return;
    }
    this.reads += 1;
    const { reads } = this;
    try {
      const { result } = await get<{ replay: Replay | null }>(this.swarm, "status");
      // The reply to a later request may have overtaken this one.
      if (result.replay && !this.held && reads === this.reads) {
        const { of, position, duration } = result.replay;
        this.duration = duration;
        setText(this.source, `playback of ${of}`);
        const share = duration > 0 ? position / duration : 1;
        this.slider.value = String(STEPS * share);
        this.showPosition(share);
      }
    } catch {
      // The picture shows that the swarm was deleted or the connection lost.
    }
  }

  end(): void {
    clearInterval(this.timer);
    this.ends.abort();
  }

  private showPosition(share: number): void {
    const text = `${time(share * this.duration)} of ${time(this.duration)}`;
    setText(this.place, text);
    this.slider.setAttribute("aria-valuetext", text);
  }

  private async seek(): Promise<void> {
    const fraction = Number(this.slider.value) / STEPS;
    this.held = true;
    this.seeks += 1;
    await attempt(() => command(this.swarm, "seek", { fraction }));
    this.seeks -= 1;
    this.release();
  }

  /** Lets the slider follow the daemon again, unless it is moved or its position is being sent. */
  private release(): void {
    if (this.held && !this.pressed && this.seeks === 0) {
      this.held = false;
      void this.refresh();
    }
  }
}
