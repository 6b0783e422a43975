/** Windows above the page. */
import { el } from "./dom.ts";

/** Opens one; it goes when it is closed, and the focus returns to where it was. */
export function openDialog(title: string, ...children: (Node | string)[]): HTMLDialogElement {
  const close = el("button", { type: "button", class: "plain close", "aria-label": "close" }, "✕");
  const heading = el("h2", {}, title);
  const dialog = el(
    "dialog",
    { "aria-label": title },
    el("header", {}, heading, close),
    ...children,
  );
  const before = document.activeElement;
  close.addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) {
      dialog.close();
    }
  });
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (before instanceof HTMLElement) {
      before.focus();
    }
  });
  document.body.append(dialog);
  dialog.showModal();
  return dialog;
}

/** Asks before something that cannot be undone. */
export function confirmDialog(title: string, text: string, verb: string): Promise<boolean> {
  return new Promise((resolve) => {
    const yes = el("button", { type: "button", class: "danger" }, verb);
    const no = el("button", { type: "button", autofocus: true }, "Keep it");
    const dialog = openDialog(title, el("p", {}, text), el("p", { class: "buttons" }, no, yes));
    let agreed = false;
    yes.addEventListener("click", () => {
      agreed = true;
      dialog.close();
    });
    no.addEventListener("click", () => dialog.close());
    dialog.addEventListener("close", () => resolve(agreed));
  });
}
