/** The help: keys and symbols. */
import { openDialog } from "./dialog.ts";
import { el } from "./dom.ts";

const KEYS: [string, string][] = [
  ["space", "run or pause"],
  ["s", "one step"],
  ["f", "follow the centre of mass and fit every body"],
  ["c", "contacts: a diamond where two bodies touch"],
  ["k", "clusters of touching bodies, numbered by size"],
  ["t", "trails"],
  ["p", "preference vector of each body: a red line, from attraction and preferred direction"],
  ["l", "lasso; with shift it adds to the selection"],
  ["d", "inform the selected: one drag sends one command, which its message can undo"],
  ["+ −", "zoom; also mouse wheel and pinch"],
  ["arrows", "pan; also dragging"],
  ["Esc", "cancel the lasso or the drag; then clear the selection"],
  ["/", "list of swarms: filter by name; arrow keys move between swarms, Esc shows all"],
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
        "red line in their preferred direction; the others are blue. Lengths are in body sizes, " +
        "speeds in free speeds, times in body sizes over free speed; directions are counter-clockwise " +
        "from +x, which points right. Click a body to select it; drag the picture to pan.",
    ),
  );
}
