/** Messages and errors, in live regions that screen readers announce. */
import { RequestError } from "../wire/http.ts";
import { button, el } from "./dom.ts";
import type { Session } from "./session.ts";

const ERROR_MS = 12_000;
const MESSAGE_MS = 4000;
/** The display time of a message with a button. */
const ACTION_MS = 20_000;

export interface Action {
  label: string;
  /** If undefined, no button is shown. */
  act: (() => Promise<void>) | undefined;
}

const errors = el("div", { class: "messages errors", role: "alert", "aria-live": "assertive" });
const notices = el("div", { class: "messages notices", role: "status", "aria-live": "polite" });

export function announcements(): HTMLElement {
  return el("div", { class: "announcements" }, notices, errors);
}

function put(region: HTMLElement, text: string, lasts: number, action?: Action): void {
  const close = button("✕", () => remove(), "plain");
  close.setAttribute("aria-label", "close");
  const run = () => {
    remove();
    return action?.act?.();
  };
  const does = action?.act && button(action.label, run, "action");
  const note = el("p", {}, el("span", {}, text), does, close);
  const timer = setTimeout(() => note.remove(), lasts);
  const remove = () => {
    clearTimeout(timer);
    note.remove();
  };
  region.replaceChildren(note);
}

export function announce(text: string, action?: Action): void {
  put(notices, text, action?.act ? ACTION_MS : MESSAGE_MS, action);
}

/** Whether this tab may send commands; announces why if it may not. */
export function checkMayCommand(session: Session): boolean {
  if (!session.mayCommand) {
    announce(session.refusal);
  }
  return session.mayCommand;
}

/** Shows an error with the daemon's message. */
export function announceError(error: unknown): void {
  errors.dataset.code = error instanceof RequestError ? error.code : "";
  put(errors, error instanceof Error ? error.message : String(error), ERROR_MS);
}

/** The daemon is back: removes the message that it does not reply. */
export function endNoReply(): void {
  if (errors.dataset.code === "no_reply") {
    errors.replaceChildren();
  }
}

/** Runs an action. If it fails, shows the error and returns null. */
export async function attempt<T>(action: () => Promise<T>, done?: string): Promise<T | null> {
  try {
    const result = await action();
    errors.replaceChildren();
    if (done) {
      announce(done);
    }
    return result;
  } catch (error) {
    announceError(error);
    return null;
  }
}
