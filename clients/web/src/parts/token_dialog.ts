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
  const people = el(
    "p",
    {},
    "This daemon knows its people: what this tab may do goes by whose token it has. Open the link " +
      "that your command line prints, ",
    el("code", {}, "jostle auth link"),
    ", or paste your token here. It is kept in this tab only.",
  );
  const dialog = openDialog(
    session.knowsPeople ? "Who you are" : "Commanding",
    session.knowsPeople
      ? people
      : el(
          "p",
          {},
          "Everybody on this machine may watch. To run, steer, create or delete swarms the page needs " +
            "the token of the daemon: open the link that jostled printed when it started, ",
          el("code", {}, "page on http://…/#token=…"),
          ", or paste the token here. It is kept in this tab only.",
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

/** The words in place of controls, for whoever may not use them. */
export function tokenNote(session: Session): HTMLElement {
  const note = el("p", { class: "note token-note" });
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

function remedy(session: Session): (string | HTMLElement)[] {
  if (session.person !== null) {
    return [`You are ${session.person}, ${session.hello?.role}: commanding takes an operator.`];
  }
  const which = session.knowsPeople ? "paste your token" : "paste its token";
  const open = el("button", { type: "button", class: "link" }, which);
  open.addEventListener("click", () => openTokenDialog(session));
  if (session.knowsPeople) {
    return ["This daemon does not know this tab: ", open, "."];
  }
  return ["You are watching. To command, open the link that jostled printed, or ", open, "."];
}
