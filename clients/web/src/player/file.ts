/** The content of the file: what `jostle export` writes into the page. */
import type { PlanFiles } from "../engine/engine.ts";

/** How base64 of gzip begins. */
const GZIP = "H4sI";

/** The newest format that this player reads. */
const FORMAT = 1;

/** The frames of a recording, or of a run without engine; `decodeFrames` reads `data`. */
export interface StoredFrames {
  count: number;
  /** The time of a frame is its step times `dt`. */
  dt: number;
  /** The length of one unit of x and y, body sizes. */
  quantum: number;
  /** The units of a heading in a full turn. */
  turn: number;
  /** The aspect ratio, each from the frame with this index on. */
  pi1: [number, number][];
  /** Base64 of gzip. */
  data: string;
}

/** What the file claims: the end of the run. */
export interface Claim {
  steps: number;
  state_hash: string;
  fault?: string;
}

/** The JSON in the file. */
export interface Content {
  format: number;
  kind: "run" | "recording";
  name: string;
  version: string;
  model_version: number;
  /** A text, or base64 of its gzip. */
  licences: string;
  files?: PlanFiles;
  run?: { index: number; name: string };
  claim?: Claim;
  frames?: StoredFrames;
}

/** What a document contains. */
export interface Contents {
  content: Content;
  /** Base64 of the compressed module; empty if the file has no engine. */
  module: string;
}

/** Reads a text of `jostle-file`; throws if this player cannot play it. */
export function parseContent(text: string): Content {
  let content: Content;
  try {
    content = JSON.parse(text) as Content;
  } catch {
    throw new Error("this file has no content: `jostle export` writes it");
  }
  if (content.format > FORMAT) {
    throw new Error(
      `this file has the format ${content.format}, made by a later version (${content.version}); ` +
        `its player reads ${FORMAT}`,
    );
  }
  return content;
}

/** Reads the document that the player is in. */
export function readContents(): Contents {
  const text = (id: string) => document.getElementById(id)?.textContent ?? "";
  const module = text("jostle-module").trim();
  return {
    content: parseContent(text("jostle-file")),
    module: module.startsWith("{") ? "" : module,
  };
}

/** The licence texts of a file. */
export async function licencesOf({ licences }: Pick<Content, "licences">): Promise<string> {
  return licences.startsWith(GZIP) ? new TextDecoder().decode(await unpack(licences)) : licences;
}

/** The bytes of base64 of gzip. */
export async function unpack(base64: string): Promise<ArrayBuffer> {
  const packed = Uint8Array.from(atob(base64), (it) => it.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}
