/** What has to be said: in a live region, for eyes and for screen readers. */
import { el } from "./dom.ts";

const ERROR_MS = 12_000;
const WORD_MS = 4000;
/** The display time of a message with a button. */
const ACTION_MS = 20_000;

export interface Action {
  label: string;
  /** If undefined, no button is shown. */
  act: (() => Promise<void>) | undefined;
}

const errors = el("div", { class: "told errors", role: "alert", "aria-live": "assertive" });
const words = el("div", { class: "told words", role: "status", "aria-live": "polite" });

export function announcements(): HTMLElement {
  return el("div", { class: "announcements" }, words, errors);
}

function put(region: HTMLElement, text: string, lasts: number, action?: Action): void {
  const close = el("button", { type: "button", class: "plain", "aria-label": "close" }, "✕");
  const act = action?.act;
  const does = act && el("button", { type: "button", class: "action" }, action.label);
  const note = el("p", {}, el("span", {}, text), does, close);
  const timer = setTimeout(() => note.remove(), lasts);
  const remove = () => {
    clearTimeout(timer);
    note.remove();
  };
  close.addEventListener("click", remove);
  does?.addEventListener("click", () => {
    remove();
    void act?.();
  });
  region.replaceChildren(note);
}

export function announce(text: string, action?: Action): void {
  put(words, text, action?.act ? ACTION_MS : WORD_MS, action);
}

/** Says an error in the daemon's own words. */
export function complain(error: unknown): void {
  put(errors, error instanceof Error ? error.message : String(error), ERROR_MS);
}

/** Does something and says what went wrong, if anything; `null` then. */
export async function attempt<T>(action: () => Promise<T>, done?: string): Promise<T | null> {
  try {
    const result = await action();
    errors.replaceChildren();
    if (done) {
      announce(done);
    }
    return result;
  } catch (error) {
    complain(error);
    return null;
  }
}
