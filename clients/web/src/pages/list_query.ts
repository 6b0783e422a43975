/** The filter and the sort order of the list, and their form in the URL: `#/?q=fish&show=running&sort=-order`. */
import type { SwarmSummary } from "../wire/messages.ts";

export const SHOWS = {
  all: () => true,
  running: (row: SwarmSummary) => row.phase === "running",
  paused: (row: SwarmSummary) => row.phase === "paused",
  faulted: (row: SwarmSummary) => row.phase === "faulted",
  playback: (row: SwarmSummary) => row.replay ?? false,
  contested: (row: SwarmSummary) => Boolean(row.contested_by),
} as const;

export type Show = keyof typeof SHOWS;

export const SORTS = {
  name: () => 0,
  order: (row: SwarmSummary) => row.order,
  n: (row: SwarmSummary) => row.n,
  informed: (row: SwarmSummary) => row.informed,
  time: (row: SwarmSummary) => row.time,
  "real-time factor": (row: SwarmSummary) => row.real_time_factor ?? -1,
} as const;

export type Sort = keyof typeof SORTS;

export interface ListQuery {
  /** Parts of the name, separated by spaces. */
  text: string;
  show: Show;
  sort: Sort;
  descending: boolean;
}

export const DEFAULT_QUERY: ListQuery = { text: "", show: "all", sort: "name", descending: false };

/** Reads a query from a URL fragment. Unknown values are ignored. */
export function parseQuery(hash: string): ListQuery {
  const fields = new URLSearchParams(hash.split("?").slice(1).join("?"));
  const show = fields.get("show") ?? "";
  const sort = fields.get("sort") ?? "";
  const name = sort.replace(/^-/, "");
  return {
    text: fields.get("q") ?? "",
    show: Object.hasOwn(SHOWS, show) ? (show as Show) : DEFAULT_QUERY.show,
    sort: Object.hasOwn(SORTS, name) ? (name as Sort) : DEFAULT_QUERY.sort,
    descending: sort.startsWith("-"),
  };
}

/** The URL fragment of a query; default values are left out. */
export function formatQuery({ text, show, sort, descending }: ListQuery): string {
  const fields = new URLSearchParams();
  if (text !== "") {
    fields.set("q", text);
  }
  if (show !== DEFAULT_QUERY.show) {
    fields.set("show", show);
  }
  if (sort !== DEFAULT_QUERY.sort || descending) {
    fields.set("sort", (descending ? "-" : "") + sort);
  }
  const encoded = fields.toString();
  return encoded === "" ? "#/" : `#/?${encoded}`;
}

/** The rows that match a query, sorted; rows with equal values are sorted by name. */
export function selectRows(rows: readonly SwarmSummary[], query: ListQuery): SwarmSummary[] {
  const words = query.text.toLowerCase().split(/\s+/).filter(Boolean);
  const shown = SHOWS[query.show];
  const value = SORTS[query.sort];
  const sign = query.descending ? -1 : 1;
  return rows
    .filter((row) => shown(row) && words.every((word) => row.swarm.includes(word)))
    .sort((a, b) => sign * (value(a) - value(b) || collator.compare(a.swarm, b.swarm)));
}

/** swarm-2 comes before swarm-10. */
const collator = new Intl.Collator("en", { numeric: true });
