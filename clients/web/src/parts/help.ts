/** The keys, and what the picture means. */
import { openDialog } from "./dialog.ts";
import { el } from "./dom.ts";

const KEYS: [string, string][] = [
  ["space", "run, pause"],
  ["s", "step"],
  ["f", "follow the centre of mass, every body whole in the picture"],
  ["c", "contacts: a diamond where two bodies touch"],
  ["k", "clusters: bodies that hang together, numbered by size"],
  ["t", "trails"],
  ["p", "preference of everybody, a red line: direction of its own and attraction"],
  ["l", "lasso; with shift it adds to the selection"],
  ["d", "drag a direction for the selected: one drag, one command, which its message can undo"],
  ["+ −", "zoom; wheel and pinch, too"],
  ["arrows", "pan; dragging, too"],
  ["Esc", "end the lasso or the drag of a direction; then clear the selection"],
  ["?", "this help"],
];

export function openHelp(): void {
  const rows = KEYS.map(([key, what]) =>
    el("tr", {}, el("th", { scope: "row" }, el("kbd", {}, key)), el("td", {}, what)),
  );
  openDialog(
    "Keys and signs",
    el("table", { class: "keys" }, el("tbody", {}, ...rows)),
    el(
      "p",
      {},
      "A body is a capsule, its head marked by a dark spot. Informed individuals are orange, with a " +
        "red line in the direction they prefer; the others are blue. Lengths are in body sizes, " +
        "speeds in free speeds, times in their quotient; directions are counter-clockwise from +x, " +
        "to the right. Click a body to select it, and drag the picture to look elsewhere.",
    ),
  );
}
