/** The pictures of the page: each is made by `npm run screenshots`, and shown by a page of the docs. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";

const web = join(import.meta.dirname, "../..");
const root = join(web, "../..");

const sorted = (names: Iterable<string>) => [...new Set(names)].sort();
/** The first group of all matches in a file. */
const found = (file: string, pattern: RegExp) =>
  [...readFileSync(file, "utf8").matchAll(pattern)].map((it) => it[1]!);

test("every picture of the page is made by one command, and shown", () => {
  const stored = readdirSync(join(root, "docs/pictures")).filter((it) => /^page.*\.png$/.test(it));
  const made = found(join(web, "screenshots.ts"), /file: "([^"]+)"/g);
  const pages = readdirSync(join(root, "docs")).filter((it) => it.endsWith(".md"));
  const texts = [join(root, "README.md"), ...pages.map((it) => join(root, "docs", it))];
  const shown = texts.flatMap((it) => found(it, /pictures\/(page[^)"]*\.png)[)"]/g));
  assert(stored.length >= 5, `found only ${stored}`);
  assert.deepEqual(sorted(made), sorted(stored));
  assert.deepEqual(sorted(shown), sorted(stored));
});
