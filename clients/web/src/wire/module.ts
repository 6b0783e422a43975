/** The engine as the daemon serves it: a WebAssembly module, and its hash. */

const PATH = "jostle.wasm";
/** The header with the SHA-256 of the module, which the daemon computes. */
const HASH_HEADER = "Jostle-Wasm-Sha256";
/** The header with that of the module that was built with the daemon; only a release sends it. */
const RELEASED_HEADER = "Jostle-Wasm-Release-Sha256";

export interface Module {
  bytes: ArrayBuffer;
  /** Its SHA-256, in hexadecimal; null if neither the browser nor the daemon computes it. */
  sha256: string | null;
  /** Whether this browser computed it. Without a secure context it cannot. */
  isComputed: boolean;
  /** The SHA-256 of the module of the daemon's release; null if the daemon is not of a release. */
  released: string | null;
}

let served: Promise<boolean> | null = null;

/** Whether the daemon has a module. Asked once. */
export function isModuleServed(): Promise<boolean> {
  served ??= fetch(PATH, { method: "HEAD" }).then(
    (response) => response.ok,
    () => {
      // No connection: asked again later.
      served = null;
      return false;
    },
  );
  return served;
}

/** Requests the module. */
export async function readModule(): Promise<Module> {
  const response = await fetch(PATH);
  if (!response.ok) {
    throw new Error(`the daemon has no engine to send: ${PATH} has status ${response.status}`);
  }
  const bytes = await response.arrayBuffer();
  const told = response.headers.get(HASH_HEADER);
  const computed = await sha256(bytes);
  const released = response.headers.get(RELEASED_HEADER);
  return { bytes, sha256: computed ?? told, isComputed: computed !== null, released };
}

/** The SHA-256 of some bytes, in hexadecimal; null where the browser has no such function, as on a page
 * from another machine without TLS. */
export async function sha256(bytes: ArrayBuffer): Promise<string | null> {
  const subtle = (globalThis.crypto as Crypto | undefined)?.subtle as SubtleCrypto | undefined;
  if (!subtle) {
    return null;
  }
  const digest = new Uint8Array(await subtle.digest("SHA-256", bytes));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
