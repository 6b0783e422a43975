/** Decodes the frames of a recording; the format is that of `jostle export`. */
import type { Frame } from "../engine/job.ts";
import type { StoredFrames } from "./file.ts";

/** A frame that is drawn. */
export interface Shown extends Omit<Frame, "drift" | "contacts"> {
  /** Null if the file does not tell. */
  drift: number | null;
  contacts: number | null;
}

/** Reads numbers of variable length, least significant bits first. */
class Reader {
  private at = 0;

  constructor(private readonly bytes: Uint8Array) {}

  /** An unsigned number below 2⁵³: too large for the operators on bits. */
  unsigned(): number {
    let value = 0;
    for (let factor = 1; ; factor *= 128) {
      const byte = this.bytes[this.at];
      if (byte === undefined || factor > 2 ** 49) {
        throw new Error(`the frames are damaged at byte ${this.at}`);
      }
      this.at += 1;
      value += (byte & 127) * factor;
      if (byte < 128) {
        return value;
      }
    }
  }

  /** 0, -1, 1, -2, … are stored as 0, 1, 2, 3, … */
  signed(): number {
    const value = this.unsigned();
    return value % 2 === 0 ? value / 2 : -(value + 1) / 2;
  }

  several(n: number, read: () => number): number[] {
    return Array.from({ length: n }, read);
  }
}

/** The quantised values of a column, by id: of the frame before, and of that before it. */
type Past = [Map<number, number>, Map<number, number>];

/** Decodes the bytes of frames. */
export function decodeFrames(
  bytes: Uint8Array,
  stored: Omit<StoredFrames, "data" | "dt">,
): Shown[] {
  const reader = new Reader(bytes);
  const { quantum, turn } = stored;
  const pasts: Past[] = [0, 1, 2].map(() => [new Map(), new Map()]);
  const units = [quantum, quantum, (2 * Math.PI) / turn];
  let step = 0;
  let ids: number[] = [];
  let informed: number[] = [];
  let pi1 = stored.pi1[0]?.[1] ?? 1;
  return reader
    .several(stored.count, () => 0)
    .map((_, index) => {
      step += reader.signed();
      const n = reader.unsigned() - 1;
      if (n >= 0) {
        let id = 0;
        ids = reader.several(n, () => {
          id += reader.signed();
          return id;
        });
        informed = reader.several(n, () => reader.unsigned());
      }
      const [x, y, alpha] = pasts.map((past, k) => {
        const values = column(reader, ids, past);
        pasts[k] = [values, past[0]];
        return Float64Array.from(ids, (id) => values.get(id)! * units[k]!);
      }) as [Float64Array, Float64Array, Float64Array];
      pi1 = stored.pi1.find(([from]) => from === index)?.[1] ?? pi1;
      return {
        step,
        id: Uint32Array.from(ids),
        x,
        y,
        alpha,
        weight: Float64Array.from(informed),
        direction: new Float64Array(ids.length).fill(Number.NaN),
        order: orderOf(alpha),
        drift: null,
        contacts: null,
        pi1,
      };
    });
}

/** A column by id: each value is stored as its difference from a prediction by the frames before. */
function column(reader: Reader, ids: number[], [last, before]: Past): Map<number, number> {
  return new Map(
    ids.map((id) => {
      const one = last.get(id);
      const two = before.get(id);
      const predicted = one === undefined ? 0 : two === undefined ? one : 2 * one - two;
      return [id, predicted + reader.signed()];
    }),
  );
}

/** The length of the mean heading. */
export function orderOf(alpha: Float64Array): number {
  const x = alpha.reduce((sum, it) => sum + Math.cos(it), 0);
  const y = alpha.reduce((sum, it) => sum + Math.sin(it), 0);
  return alpha.length === 0 ? 0 : Math.hypot(x, y) / alpha.length;
}
