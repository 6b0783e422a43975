/** How a person comes to command: with the token that the daemon printed. */
import { openDialog } from "./dialog.ts";
import { el, say } from "./dom.ts";
import { form } from "./field.ts";
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
  const told = el("p", { role: "status" });
  const forget = el("button", { type: "button" }, "Forget it");
  const entry = form(
    { class: "row" },
    async () => {
      if (await session.useToken(field.value)) {
        dialog.close();
      } else {
        say(told, "This is not this daemon's token, or the daemon is away.");
      }
    },
    field,
    el("button", { class: "primary" }, "Use it"),
  );
  forget.addEventListener("click", () => {
    void session.useToken("");
    dialog.close();
  });
  const dialog = openDialog(
    session.knowsPeople ? "Who you are" : "Commanding",
    el("p", {}, missing(session), " Run on ", machine(session), ":"),
    shellCommand(session.linkCommand),
    el(
      "p",
      {},
      "Open the link that it prints, or paste the link here. It is kept in this tab only.",
    ),
    entry,
    told,
    session.hasToken ? el("p", {}, words(session), forget) : "",
  );
}

/** What the token of this tab comes to. */
function words(session: Session): string {
  if (session.person !== null) {
    return `This tab is ${session.person}, ${session.hello?.role}. `;
  }
  return session.mayCommand ? "This tab may command. " : "This tab has a token, but a wrong one. ";
}

/** What a tab without a token may do, and what it needs to do more. */
function missing(session: Session): string {
  if (session.knowsPeople) {
    return "This daemon shows itself only to people that it knows, by their token.";
  }
  return session.hasToken
    ? "You are watching: the token of this tab is not this daemon's."
    : "You are watching: to run, steer, create or delete swarms this tab needs the daemon's token.";
}

/** Where the command that prints the link has to run. */
function machine(session: Session): string {
  if (session.knowsPeople) {
    return "your machine, with your folder of credentials";
  }
  return session.hello ? `${session.hello.node}, the daemon's machine` : "the daemon's machine";
}

/** A command to run in a shell, and a button that copies it. */
function shellCommand(text: string): HTMLElement {
  const copy = el("button", { type: "button" }, "Copy");
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text);
      say(copy, "Copied");
    } catch {
      getSelection()?.selectAllChildren(code);
      say(copy, "Selected");
    }
  });
  const code = el("code", {}, text);
  return el("div", { class: "shell" }, code, copy);
}

/** A note shown in place of the controls if this tab may not send commands. */
export function tokenNote(session: Session): HTMLElement {
  const note = el("div", { class: "note token-note" });
  // Pages come and go, the session stays: it is not to keep their notes.
  const held = new WeakRef(note);
  const end = session.onChange(() => {
    const it = held.deref();
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
    const said = `You are ${session.person}, ${session.hello?.role}: commanding takes an operator.`;
    return [el("p", {}, said)];
  }
  if (session.hello === null) {
    return [el("p", {}, "Asking the daemon what this tab may do …")];
  }
  const open = el("button", { type: "button", class: "link" }, "paste the link");
  open.addEventListener("click", () => openTokenDialog(session));
  return [
    el("p", {}, missing(session), " Run on ", machine(session), ":"),
    shellCommand(session.linkCommand),
    el("p", {}, "Open the link that it prints, or ", open, "."),
  ];
}
