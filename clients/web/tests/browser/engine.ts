/** The engine that `packaging/wasm` builds, which the daemon serves and `jostle export` puts into files. */
import assert from "node:assert/strict";
import { appendFileSync, existsSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { gunzipSync } from "node:zlib";

/** Whether this machine may lack something, by its name in JOSTLE_MAY_SKIP. */
function maySkip(name: string): boolean {
  return (process.env.JOSTLE_MAY_SKIP ?? "").split(/[ ,]+/).includes(name);
}

/** Why the tests of a file that need something are skipped; false if they are not. Fails if the machine
 * lacks it and may not. */
export function lacks(name: string, has: boolean, remedy: string, tests: string): string | false {
  if (has) {
    return false;
  }
  assert(maySkip(name), remedy);
  if (process.env.JOSTLE_SKIPPED) {
    appendFileSync(process.env.JOSTLE_SKIPPED, `${name}: ${tests}\n`);
  }
  return remedy;
}

/** The file that the daemon of the tests serves. */
const PATH = join(dirname(process.env.JOSTLED ?? ""), "../share/jostle/jostle.wasm.gz");

export function lacksEngine(tests: string): string | false {
  return lacks("wasm", existsSync(PATH), `no engine at ${PATH}: run packaging/wasm`, tests);
}

/** The module, uncompressed. */
export function readEngine(): Buffer {
  return gunzipSync(readFileSync(PATH));
}
