/** The dialog that takes a token, and the notes about missing permissions. */
import { openDialog } from "./dialog.ts";
import { button, el, setText } from "./dom.ts";
import { rowForm } from "./field.ts";
import type { Session } from "./session.ts";

export function openTokenDialog(session: Session): void {
  const field = el("input", {
    type: "password",
    autocomplete: "off",
    spellcheck: "false",
    required: true,
    autofocus: true,
    "aria-label": "token, or the link with it",
    placeholder: "token, or the whole link",
  });
  const result = el("p", { role: "status" });
  const remove = button("Remove the token", () => {
    void session.useToken("");
    dialog.close();
  });
  const entry = rowForm(
    async () => {
      if (await session.useToken(field.value)) {
        dialog.close();
      } else {
        setText(result, "The daemon rejected this token, or does not respond.");
      }
    },
    field,
    el("button", { class: "primary" }, "Use token"),
  );
  const dialog = openDialog(
    session.hasUsers ? "Your access" : "Permission to send commands",
    el("p", {}, missing(session), " Run on ", machine(session), ":"),
    shellCommand(session.linkCommand),
    el(
      "p",
      {},
      "Open the link that it prints, or paste the link here. The token stays in this tab.",
    ),
    entry,
    result,
    session.hasToken ? el("p", {}, permissions(session), remove) : "",
  );
}

/** What this tab's token permits. */
function permissions(session: Session): string {
  if (session.person !== null) {
    return `You are ${session.person}, ${session.hello?.role}. `;
  }
  return session.mayCommand
    ? "This tab may send commands. "
    : "This tab has a token that the daemon does not accept. ";
}

/** Why the page has no connection. */
export function lostText(session: Session): string {
  if (session.mayWatch) {
    return "No connection to the daemon, reconnecting …";
  }
  return session.hasToken
    ? "This daemon rejected the token of this tab."
    : "This daemon requires a user's token.";
}

/** What this tab may not do, and what it needs. */
function missing(session: Session): string {
  if (session.hasUsers && !session.mayWatch && session.hasToken) {
    return "This daemon rejected the token of this tab: its user was removed, or has got a new token.";
  }
  if (session.hasUsers) {
    return "This daemon requires a user's token, also to watch.";
  }
  if (session.mayCommand) {
    return "To open this page with its token in another tab or browser you need the link.";
  }
  return session.hasToken
    ? "You are watching: the token of this tab is not this daemon's."
    : "You are watching: to run, steer, create or delete swarms this tab needs the daemon's token.";
}

/** The machine on which to run the command that prints the link. */
function machine(session: Session): string {
  if (session.hasUsers) {
    return "your machine, with your credentials folder";
  }
  return session.hello ? `${session.hello.node}, the daemon's machine` : "the daemon's machine";
}

/** A shell command with a button that copies it. */
function shellCommand(text: string): HTMLElement {
  const copy = button("Copy", async () => {
    try {
      await navigator.clipboard.writeText(text);
      setText(copy, "Copied");
    } catch {
      getSelection()?.selectAllChildren(code);
      setText(copy, "Selected");
    }
  });
  const code = el("code", {}, text);
  return el("div", { class: "shell" }, code, copy);
}

/** A note for tabs that may not send commands. */
export function tokenNote(session: Session): HTMLElement {
  const note = el("div", { class: "note token-note" });
  // The session outlives the pages: a strong reference would leak their notes.
  const reference = new WeakRef(note);
  const end = session.onChange(() => {
    const it = reference.deref();
    if (it) {
      it.replaceChildren(...remedy(session));
    } else {
      end();
    }
  });
  return note;
}

/** Explains why this tab may not send commands, with the shell command that prints the link. */
export function remedy(session: Session): HTMLElement[] {
  if (session.person !== null) {
    const text = `You are ${session.person}, ${session.hello?.role}: commands require the role operator.`;
    return [el("p", {}, text)];
  }
  if (session.hello === null) {
    return [el("p", {}, "Requesting the permissions of this tab …")];
  }
  const open = button("paste the link", () => openTokenDialog(session), "link");
  return [
    el("p", {}, missing(session), " Run on ", machine(session), ":"),
    shellCommand(session.linkCommand),
    el("p", {}, "Open the link that it prints, or ", open, "."),
  ];
}
