/** The menu of charts: series that the page draws by itself, and measures that the daemon computes. */
import { el } from "../ui/dom.ts";
import { get } from "../wire/http.ts";
import type { Measures } from "../wire/messages.ts";
import { store, stored } from "../wire/storage.ts";

const KEY = "charts";

/** The measures that are series, too. */
const SERIES_TOO = ["order", "drift"];

export class ChartMenu {
  readonly element: HTMLDetailsElement;
  /** The names of the charts that are shown. */
  readonly chosen: string[];
  private readonly list = el("div", { class: "choices" });
  private hasMeasures = false;

  constructor(
    private readonly swarm: string,
    series: ReadonlyMap<string, string>,
    private readonly choose: (names: readonly string[]) => void,
  ) {
    this.chosen = readChosen() ?? [...series.keys()];
    for (const [name, title] of series) {
      this.addChoice(name, title);
    }
    this.element = el(
      "details",
      { class: "chart-menu", ontoggle: () => void this.addMeasures() },
      el("summary", { title: "choose what to draw" }, "Charts"),
      this.list,
    );
  }

  /** Adds the measures of the daemon once the menu is opened. */
  private async addMeasures(): Promise<void> {
    if (this.hasMeasures || !this.element.open) {
      return;
    }
    this.hasMeasures = true;
    try {
      const { result } = await get<Measures>(this.swarm, "measures");
      for (const { name, unit } of result.measures) {
        if (!SERIES_TOO.includes(name)) {
          this.addChoice(name, name, unit === "1" ? "without unit" : `in ${unit}`);
        }
      }
    } catch {
      // It is requested again when the menu is opened again.
      this.hasMeasures = false;
    }
  }

  private addChoice(name: string, title: string, about?: string): void {
    const box = el("input", {
      type: "checkbox",
      checked: this.chosen.includes(name),
      onchange: (event) => this.set(name, (event.target as HTMLInputElement).checked),
    });
    this.list.append(el("label", { title: about }, box, title));
  }

  private set(name: string, isChosen: boolean): void {
    const at = this.chosen.indexOf(name);
    if (isChosen && at < 0) {
      this.chosen.push(name);
    } else if (!isChosen && at >= 0) {
      this.chosen.splice(at, 1);
    }
    store(KEY, JSON.stringify(this.chosen));
    this.choose(this.chosen);
  }
}

/** The choice in this tab, if it is one. */
function readChosen(): string[] | null {
  try {
    const names: unknown = JSON.parse(stored(KEY) ?? "null");
    const isChoice = Array.isArray(names) && names.every((name) => typeof name === "string");
    return isChoice ? names : null;
  } catch {
    return null;
  }
}
