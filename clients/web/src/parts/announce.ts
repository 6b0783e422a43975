/** What has to be said: in a live region, for eyes and for screen readers. */
import { Refused } from "../wire/http.ts";
import { el } from "./dom.ts";

const ERROR_MS = 12_000;
const WORD_MS = 4000;

const errors = el("div", { class: "told errors", role: "alert", "aria-live": "assertive" });
const words = el("div", { class: "told words", role: "status", "aria-live": "polite" });

export function announcements(): HTMLElement {
  return el("div", { class: "announcements" }, words, errors);
}

function put(region: HTMLElement, text: string, lasts: number): void {
  const close = el("button", { type: "button", class: "plain", "aria-label": "close" }, "✕");
  const note = el("p", {}, el("span", {}, text), close);
  const timer = setTimeout(() => note.remove(), lasts);
  close.addEventListener("click", () => {
    clearTimeout(timer);
    note.remove();
  });
  region.replaceChildren(note);
}

export function announce(text: string): void {
  put(words, text, WORD_MS);
}

/** Says an error in the daemon's own words. */
export function complain(error: unknown): void {
  const text =
    error instanceof Refused && error.code === "permission_denied"
      ? `${error.message}. Open the link that jostled printed, or paste its token.`
      : error instanceof Error
        ? error.message
        : String(error);
  put(errors, text, ERROR_MS);
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
