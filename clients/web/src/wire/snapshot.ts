/** Reads a snapshot as the daemon sends it: a reply in CBOR whose result is the snapshot. */
import { decodeFirst } from "cborg";
import { OPTIONS } from "./state.ts";

/** A snapshot, and what the page reads of it. */
export interface Snapshot {
  /** Its CBOR. */
  bytes: Uint8Array;
  epoch: number;
  step: number;
  /** The number of the last command. */
  seq: number;
  /** How many of them were annotations, which the numbers of random draws leave out. */
  annotations: number;
  state_hash: string;
}

/** The major type of a map, whose length is in the other five bits if it is below 24. */
const MAP = 5;

/** Finds the snapshot in a reply; throws if there is none. The bytes of the snapshot are not encoded
 * again, which could change them. */
export function readSnapshot(reply: Uint8Array): Snapshot {
  const entries = reply[0] === undefined || reply[0] >> 5 !== MAP ? 0 : reply[0] & 31;
  let rest = reply.subarray(1);
  for (let k = 0; k < entries && entries < 24; k += 1) {
    const [name, after] = decodeFirst(rest, OPTIONS) as [unknown, Uint8Array];
    const [value, next] = decodeFirst(after, OPTIONS) as [unknown, Uint8Array];
    if (name === "result") {
      const bytes = after.slice(0, after.length - next.length);
      const read = value as Omit<Snapshot, "bytes" | "annotations"> & { annotations?: number };
      return { ...read, annotations: read.annotations ?? 0, bytes };
    }
    rest = next;
  }
  throw new Error("the reply contains no snapshot");
}
