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
    "Commanding",
    el(
      "p",
      {},
      "Everybody on this machine may watch. To run, steer, create or delete swarms the page needs " +
        "the token of the daemon: open the link that jostled printed when it started, ",
      el("code", {}, "page on http://…/#token=…"),
      ", or paste the token here. It is kept in this tab only.",
    ),
    entry,
    told,
    session.hasToken
      ? el(
          "p",
          {},
          session.mayCommand ? "This tab may command. " : "This tab has a token, but a wrong one. ",
          forget,
        )
      : "",
  );
}

/** The words in place of controls, where there is no token. */
export function tokenNote(session: Session): HTMLElement {
  const open = el("button", { type: "button", class: "link" }, "paste its token");
  open.addEventListener("click", () => openTokenDialog(session));
  return el(
    "p",
    { class: "note token-note" },
    "You are watching. To command, open the link that jostled printed, or ",
    open,
    ".",
  );
}
