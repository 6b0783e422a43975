/** Modal dialogs. */
import { button, el } from "./dom.ts";

/** Opens a dialog. When it is closed it is removed and the focus returns to the previous element. */
export function openDialog(title: string, ...children: (Node | string)[]): HTMLDialogElement {
  const close = button("✕", () => dialog.close(), "plain close");
  close.setAttribute("aria-label", "close");
  const heading = el("h2", {}, title);
  const dialog = el(
    "dialog",
    { "aria-label": title },
    el("header", {}, heading, close),
    ...children,
  );
  const before = document.activeElement;
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

/** Asks for confirmation of an action that cannot be undone; the signal closes the dialog. */
export function confirmDialog(
  title: string,
  text: string,
  verb: string,
  signal: AbortSignal,
): Promise<boolean> {
  return new Promise((resolve) => {
    const close = (agreed: boolean) => {
      resolve(agreed);
      dialog.close();
    };
    const yes = button(verb, () => close(true), "danger");
    const no = button("Cancel", () => close(false));
    no.autofocus = true;
    const dialog = openDialog(title, el("p", {}, text), el("p", { class: "buttons" }, no, yes));
    dialog.addEventListener("close", () => resolve(false));
    signal.addEventListener("abort", () => close(false));
  });
}
