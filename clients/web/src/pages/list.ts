/** The list of the daemon's swarms, with a filter, a sort order and live thumbnails. */
import { SwarmCard } from "../panels/swarm_card.ts";
import { Thumbnails } from "../panels/thumbnails.ts";
import { button, callAll, el, setText } from "../ui/dom.ts";
import { selectField } from "../ui/field.ts";
import type { Page } from "../ui/router.ts";
import type { Session } from "../ui/session.ts";
import { tokenNote } from "../ui/token_dialog.ts";
import type { SwarmSummary } from "../wire/messages.ts";
import { openCreate } from "./create.ts";
import {
  DEFAULT_QUERY,
  formatQuery,
  type ListQuery,
  parseQuery,
  SHOWS,
  type Show,
  SORTS,
  type Sort,
  selectRows,
} from "./list_query.ts";

/** Up to this many swarms have large cards. */
const MAX_LARGE_CARDS = 8;

/** The form above the list. Calls `changed` with each change of the query. */
class QueryForm {
  readonly element: HTMLElement;
  query = parseQuery(location.hash);
  private readonly text = el("input", {
    type: "search",
    placeholder: "Filter by name ( / )",
    "aria-label": "filter by name",
    "aria-keyshortcuts": "/",
    autocomplete: "off",
    autocapitalize: "off",
    spellcheck: "false",
  });
  private readonly show = selectField("show", Object.keys(SHOWS));
  private readonly sort = selectField("sort by", Object.keys(SORTS));
  private readonly direction = button("", () => this.set({ descending: !this.query.descending }));

  constructor(
    private readonly changed: () => void,
    enterList: () => void,
  ) {
    this.text.addEventListener("input", () => this.set({ text: this.text.value }));
    this.text.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === "ArrowDown") {
        event.preventDefault();
        enterList();
      }
    });
    this.show.select.addEventListener("change", () =>
      this.set({ show: this.show.select.value as Show }),
    );
    this.sort.select.addEventListener("change", () =>
      this.set({ sort: this.sort.select.value as Sort }),
    );
    this.element = el(
      "search",
      { class: "list-query", "aria-label": "swarms" },
      this.text,
      this.show.label,
      this.sort.label,
      this.direction,
    );
    this.fill();
  }

  focus(): void {
    this.text.focus();
    this.text.select();
  }

  /** Shows all swarms; returns whether any were filtered out before. */
  clear(): boolean {
    const { text, show } = DEFAULT_QUERY;
    const isFiltered = this.query.text !== text || this.query.show !== show;
    this.set({ text, show });
    return isFiltered;
  }

  private set(change: Partial<ListQuery>): void {
    this.query = { ...this.query, ...change };
    // A new history entry for each letter would make the Back button useless.
    history.replaceState(null, "", formatQuery(this.query));
    this.fill();
    this.changed();
  }

  private fill(): void {
    const { text, show, sort, descending } = this.query;
    if (this.text.value !== text) {
      this.text.value = text;
    }
    this.show.select.value = show;
    this.sort.select.value = sort;
    setText(this.direction, descending ? "↓" : "↑");
    const label = descending ? "descending" : "ascending";
    this.direction.setAttribute("aria-label", `sort order: ${label}`);
    this.direction.title = label;
  }
}

/** Moves the focus between the cards of a grid; returns whether the key does that. */
function moveFocus(grid: HTMLElement, key: string): boolean {
  const cards = [...grid.children] as HTMLElement[];
  const at = cards.indexOf(document.activeElement as HTMLElement);
  if (at < 0) {
    return false;
  }
  const columns = cards.filter((it) => it.offsetTop === cards[0]!.offsetTop).length;
  const moves: Record<string, number> = {
    ArrowRight: at + 1,
    ArrowLeft: at - 1,
    ArrowDown: at + columns,
    ArrowUp: at - columns,
    Home: 0,
    End: cards.length - 1,
  };
  const to = moves[key];
  if (to === undefined) {
    return false;
  }
  cards[to]?.focus();
  return true;
}

/** Makes the elements the children of a grid, in this order, with as few moves as possible. */
function setChildren(grid: HTMLElement, elements: readonly HTMLElement[]): void {
  const wanted = new Set<Element>(elements);
  for (const child of [...grid.children]) {
    if (!wanted.has(child)) {
      child.remove();
    }
  }
  elements.forEach((element, k) => {
    if (grid.children[k] !== element) {
      grid.insertBefore(element, grid.children[k] ?? null);
    }
  });
}

export function listPage(session: Session): Page {
  const cards = new Map<string, SwarmCard>();
  const byElement = new Map<Element, SwarmCard>();
  let rows: SwarmSummary[] = [];
  const grid = el("div", { class: "cards swarm-cards" });
  const count = el("p", { class: "soft", role: "status" });
  const hint = el("span", {});
  const empty = el(
    "div",
    { class: "empty", hidden: true },
    el("h2", {}, "This daemon has no swarms."),
    el("p", {}, hint, el("a", { href: "#/gallery" }, "gallery"), "."),
  );
  const clear = button("Show all swarms", () => {
    form.clear();
    form.focus();
  });
  const noMatch = el(
    "div",
    { class: "empty", hidden: true },
    el("p", {}, "No swarm matches the filter."),
    clear,
  );
  const create = button("Create a swarm …", openCreate, "primary");
  const form = new QueryForm(
    () => arrange(true),
    () => (grid.firstElementChild as HTMLElement | null)?.focus(),
  );
  const note = tokenNote(session);
  const element = el(
    "div",
    { class: "page list-page" },
    el(
      "header",
      { class: "page-head" },
      el("div", {}, el("h1", {}, "Swarms"), count),
      form.element,
      create,
    ),
    note,
    empty,
    noMatch,
    grid,
  );

  const update = (card: SwarmCard, row: SwarmSummary) =>
    card.show(row, session.orders.get(card.swarm) ?? []);
  const thumbnails = new Thumbnails((target, visible) => {
    const card = byElement.get(target)!;
    card.visible = visible;
    const row = rows.find((it) => it.swarm === card.swarm);
    if (row && visible) {
      update(card, row);
    }
  });

  const discard = (card: SwarmCard) => {
    thumbnails.remove(card.element);
    byElement.delete(card.element);
    cards.delete(card.swarm);
  };
  const cardOf = (row: SwarmSummary) => {
    const existing = cards.get(row.swarm);
    if (existing) {
      return existing;
    }
    const card = new SwarmCard(row.swarm);
    cards.set(row.swarm, card);
    byElement.set(card.element, card);
    thumbnails.add(card.element, row.swarm, card.canvas);
    update(card, row);
    return card;
  };

  /** Shows the rows that match. Unless `sorts` is true, cards in use keep their place. */
  const arrange = (sorts: boolean) => {
    const selected = selectRows(rows, form.query);
    if (!sorts && grid.matches(":hover, :focus-within")) {
      const position = new Map([...grid.children].map((it, k) => [it, k]));
      const at = (row: SwarmSummary) => position.get(cardOf(row).element) ?? rows.length;
      selected.sort((a, b) => at(a) - at(b));
    }
    setChildren(
      grid,
      selected.map((row) => cardOf(row).element),
    );
    grid.classList.toggle("few", rows.length <= MAX_LARGE_CARDS);
    empty.hidden = rows.length > 0;
    noMatch.hidden = rows.length === 0 || selected.length > 0;
    form.element.hidden = rows.length === 0;
    const running = rows.filter((row) => row.phase === "running").length;
    const shown = selected.length < rows.length ? `${selected.length} of ` : "";
    setText(
      count,
      rows.length === 0
        ? ""
        : `${shown}${rows.length} on ${session.hello?.node ?? "this daemon"}, ${running} running`,
    );
  };

  const show = (received: SwarmSummary[]) => {
    rows = received;
    const present = new Set(rows.map((row) => row.swarm));
    for (const card of [...cards.values()]) {
      if (!present.has(card.swarm)) {
        discard(card);
      }
    }
    // Creates the cards in the order in which they are shown: the first thumbnails come first.
    arrange(false);
    for (const row of rows) {
      const card = cardOf(row);
      // Cards outside the viewport are updated when they enter it.
      if (card.visible) {
        update(card, row);
      }
      thumbnails.show(card.element, row);
    }
  };

  session.live.watch(null);
  thumbnails.follow(session.live, element, show);
  const ends = [
    session.onChange(() => {
      note.hidden = session.mayCommand;
      create.hidden = !session.mayCommand;
      setText(
        hint,
        session.mayCommand
          ? "Create one, or open the "
          : "With a token you can create one. Open the ",
      );
    }),
    () => thumbnails.end(),
  ];
  return {
    element,
    title: "Swarms",
    key: (event) => {
      if (event.key === "/") {
        form.focus();
        return true;
      }
      if (event.key === "Escape") {
        return form.clear();
      }
      return moveFocus(grid, event.key);
    },
    end: () => callAll(ends),
  };
}
