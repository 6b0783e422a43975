/**
 * Decodes a state: a CBOR map whose columns are typed arrays of RFC 8746.
 *
 * Positions are `1024 · origin + (x, y)`. The page keeps them relative to the origin and never adds
 * the two, which would lose precision.
 */
import { decode } from "cborg";
import type { Certificate, Order } from "./messages.ts";
import type { Stamp } from "./page.ts";

/** The unit of the origin, in body sizes. */
export const ORIGIN_UNIT = 1024;

export type Origin = readonly [number, number];

/** A swarm: a column for each quantity, an entry for each individual. */
export interface Columns {
  id: Uint32Array;
  x: Float64Array;
  y: Float64Array;
  alpha: Float64Array;
  weight: Float64Array;
  /** NaN of an uninformed individual. */
  direction: Float64Array;
}

/** What a picture is drawn from. */
export interface Drawn extends Columns, Omit<Stamp, "swarm"> {
  origin: Origin;
}

export interface State extends Stamp, Drawn {
  order: Order;
  certificate: Certificate;
}

const UINT32_LITTLE = 70;
const FLOAT64_LITTLE = 86;

type Inner = Uint8Array | (() => Uint8Array);

/** A copy of the bytes of a tagged byte string, since a column of doubles must be aligned. */
function bytesOf(inner: Inner): ArrayBuffer {
  const bytes = typeof inner === "function" ? inner() : inner;
  return bytes.slice().buffer as ArrayBuffer;
}

const tags: ((inner: Inner) => unknown)[] = [];
tags[UINT32_LITTLE] = (inner) => new Uint32Array(bytesOf(inner));
tags[FLOAT64_LITTLE] = (inner) => new Float64Array(bytesOf(inner));

/** How CBOR with such columns is decoded. */
export const OPTIONS = { tags } as unknown as NonNullable<Parameters<typeof decode>[1]>;

/** Decodes a state; throws if it is invalid. */
export function decodeState(bytes: ArrayBuffer | Uint8Array): State {
  const view = bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes);
  const state = decode(view, OPTIONS) as State;
  const n = state.id.length;
  for (const column of [state.x, state.y, state.alpha, state.weight, state.direction]) {
    if (column.length !== n) {
      throw new Error(`a column has ${column.length} entries, not ${n}`);
    }
  }
  return state;
}

/** The exact shift of positions when the origin changes. */
export function shift(from: Origin, to: Origin): [number, number] {
  return [ORIGIN_UNIT * (from[0] - to[0]), ORIGIN_UNIT * (from[1] - to[1])];
}
