/** Checks a page with axe-core. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import type { AxeResults } from "axe-core";
import type { Page } from "playwright-core";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

/** Runs axe-core in the page and fails for each violation with the impact serious or critical. */
export async function check(page: Page, where: string): Promise<void> {
  // The page's policy permits no injected script element; an evaluated text is no part of the page.
  await page.evaluate(AXE);
  const { violations, passes } = await page.evaluate<AxeResults>(
    "axe.run({ resultTypes: ['violations'] })",
  );
  assert(passes.length > 5, `${where}: axe-core ran ${passes.length} rules`);
  const found = violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .map(({ id, nodes }) => `${id}: ${nodes.map((it) => it.html).join(" ")}`);
  assert.deepEqual(found, [], where);
}
