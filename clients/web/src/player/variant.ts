/** Changes a parameter in the text of an experiment file. */
import type { PlanFiles } from "../engine/engine.ts";

/** The parameters that a reader may change: a part of the table `spec`, but the first two. */
export const VARIED = ["seed", "duration", "n", "pi1", "pi2", "pi3", "pi4", "noise"] as const;
export type Varied = (typeof VARIED)[number];

const NUMBER = /^[-+]?[\d._]+(?:e[-+]?\d+)?/i;

/** The key of a parameter at the top of the file, if it is there. */
const TOP: Partial<Record<string, string>> = { seed: "seeds", duration: "duration" };

interface Place {
  /** The index of the line with the value; null if there is none. */
  line: number | null;
  /** The index of the first line after the header of the table; null if there is no such table. */
  table: number | null;
}

/** Where a key of a table is; the table "" is the top of the file. */
function find(lines: readonly string[], table: string, key: string): Place {
  let current = "";
  const place: Place = { line: null, table: table === "" ? 0 : null };
  lines.forEach((line, k) => {
    const header = /^\s*(\[+[^\]]+\]+)\s*(?:#.*)?$/.exec(line)?.[1];
    if (header && !/^\s*\[\s*\d/.test(line)) {
      current = header.replace(/[\s[\]]/g, "");
      place.table ??= current === table ? k + 1 : null;
    } else if (current === table && new RegExp(`^\\s*${key}\\s*=`).test(line)) {
      place.line = k;
    }
  });
  return place;
}

/** The number that a file states for a parameter; null if it states none. */
export function valueIn(toml: string, name: Varied): number | null {
  const lines = toml.split("\n");
  const top = TOP[name];
  const { line } = find(lines, top ? "" : "spec", top ?? name);
  const text = line === null ? "" : lines[line]!.replace(/^[^=]*=\s*\[?\s*/, "");
  const found = NUMBER.exec(text)?.[0];
  return found === undefined ? null : Number(found.replaceAll("_", ""));
}

/** The parameters that a snapshot determines. */
const FIXED: readonly Varied[] = ["n", "pi1"];

/** Whether a changed value of a parameter is that of each run: not if a grid or points vary it, or if the
 * runs start from a snapshot that determines it. */
export function mayVary({ toml, points, start }: PlanFiles, name: Varied): boolean {
  if (start !== undefined && FIXED.includes(name)) {
    return false;
  }
  const lines = toml.split("\n");
  if (name === "seed") {
    // Of several seeds or replicates it would be another run.
    return lines.some((line) => /^\s*seeds\s*=\s*\[\s*\d+\s*,?\s*\]/.test(line));
  }
  if (name === "duration") {
    return find(lines, "", "duration").line !== null;
  }
  const columns = points?.split("\n", 1)[0]?.split(",") ?? [];
  const inGrid = find(lines, "grid", name).line !== null;
  return !inGrid && !columns.some((it) => it.trim() === name);
}

/** The text of the file with another value of a parameter. */
export function withValue(toml: string, name: Varied, value: number): string {
  const lines = toml.split("\n");
  const top = TOP[name];
  const { line, table } = find(lines, top ? "" : "spec", top ?? name);
  const text = name === "n" || name === "seed" ? String(value) : real(value);
  const entry = name === "seed" ? `seeds = [${text}]` : `${name} = ${text}`;
  if (line !== null) {
    lines[line] = entry;
  } else if (table !== null) {
    lines.splice(table, 0, entry);
  } else {
    lines.push("", "[spec]", entry, "");
  }
  return lines.join("\n");
}

/** A number that TOML reads as one with a fraction. */
function real(value: number): string {
  const text = String(value);
  return /[.e]/.test(text) ? text : `${text}.0`;
}
