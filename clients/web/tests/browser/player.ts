/** Makes the files that `jostle export` makes, from the player that the CLI embeds. */
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { gzipSync } from "node:zlib";
import type { Content } from "../../src/player/file.ts";
import { Daemon } from "./daemon.ts";

const PLAYER = join(import.meta.dirname, "../../../dist-player/player.html");

/** What each file has. */
export const BASE = { format: 1, version: "0.1.0", model_version: 7, licences: "the licences" };

/** The run of a swarm, as a daemon exports it. */
export async function exportRun(): Promise<Content> {
  const daemon = await Daemon.start();
  try {
    await daemon.create("school", { n: 50, seed: 3 });
    await daemon.command("school", "inform", { select: { count: 10 }, direction: 0.4 });
    await daemon.command("school", "step", { steps: 5000 });
    const { result } = await daemon.get<{
      result: { file: string; steps: number; state_hash: string };
    }>("school/get/experiment");
    const { file: toml, steps, state_hash } = result;
    const run = { index: 0, name: "#0" };
    return {
      ...BASE,
      kind: "run",
      name: "school",
      files: { toml },
      run,
      claim: { steps, state_hash },
    };
  } finally {
    await daemon.end();
  }
}

/** Writes the file of some content into a folder; `module` is that of the engine, if the file has one.
 * Returns its address. */
export function writePlayer(folder: string, content: Content, module: Uint8Array | null): string {
  const texts = {
    title: content.name,
    file: JSON.stringify(content).replaceAll("<", "\\u003c"),
    module: module ? gzipSync(module).toString("base64") : "",
  };
  let html = readFileSync(PLAYER, "utf8");
  for (const [place, text] of Object.entries(texts)) {
    html = html.replace(`{{jostle:${place}}}`, () => text);
  }
  const path = join(folder, `${content.name}.html`);
  writeFileSync(path, html);
  return pathToFileURL(path).href;
}
