/** The modules of the page import one another without circles. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { test } from "node:test";

type Graph = Map<string, string[]>;

const IMPORT = /^\s*(?:import|export)\b[^;]*?from\s+"(\.[^"]+\.ts)"|^\s*import\s+"(\.[^"]+\.ts)"/gm;

/** The modules that a text imports, type-only imports included. */
function importsOf(path: string, text: string): string[] {
  return [...text.matchAll(IMPORT)].map((it) => join(dirname(path), it[1] ?? it[2] ?? ""));
}

/** The modules of a circle, the first repeated at the end; null if there is none. */
function findCircle(graph: Graph): string[] | null {
  const finished = new Set<string>();
  const visit = (module: string, path: string[]): string[] | null => {
    if (path.includes(module)) {
      return [...path.slice(path.indexOf(module)), module];
    }
    if (finished.has(module)) {
      return null;
    }
    for (const next of graph.get(module) ?? []) {
      const circle = visit(next, [...path, module]);
      if (circle) {
        return circle;
      }
    }
    finished.add(module);
    return null;
  };
  for (const module of graph.keys()) {
    const circle = visit(module, []);
    if (circle) {
      return circle;
    }
  }
  return null;
}

function readGraph(folder: string): Graph {
  const graph: Graph = new Map();
  for (const entry of readdirSync(folder, { recursive: true, withFileTypes: true })) {
    if (entry.isFile() && /(?<!\.d)\.ts$/.test(entry.name)) {
      const path = relative(folder, join(entry.parentPath, entry.name));
      graph.set(path, importsOf(path, readFileSync(join(folder, path), "utf8")));
    }
  }
  return graph;
}

test("no module imports itself through others", () => {
  const graph = readGraph(join(import.meta.dirname, "../../src"));
  const unknown = [...graph.values()].flat().filter((it) => !graph.has(it));
  assert.deepEqual(unknown, [], "imported modules that were not read");
  // Without imports the search for circles would prove nothing.
  assert((graph.get("main.ts") ?? []).includes("pages/list.ts"));
  assert.equal(findCircle(graph), null);
});

test("the search finds a circle, also through type-only and multi-line imports", () => {
  const graph: Graph = new Map([
    ["a/one.ts", importsOf("a/one.ts", 'import {\n  type Two,\n  two,\n} from "../b/two.ts";\n')],
    ["b/two.ts", importsOf("b/two.ts", 'import "./three.ts";\n')],
    ["b/three.ts", importsOf("b/three.ts", 'export type { One } from "../a/one.ts";\n')],
  ]);
  assert.deepEqual(findCircle(graph), ["a/one.ts", "b/two.ts", "b/three.ts", "a/one.ts"]);
  graph.set("b/three.ts", []);
  assert.equal(findCircle(graph), null);
});
