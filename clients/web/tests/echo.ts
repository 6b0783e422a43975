/**
 * A module with the exports of the engine, in place of the engine: its reply is the request. It traps if
 * the request has more than MOST bytes. Column c begins at 8 (c + 1) bytes, has one entry, and is asked
 * for with a memory that then grows.
 */

/** The most bytes of a request. */
export const MOST = 200;

const I32 = 0x7f;
/** Where a request is written. */
const PLACE = 1024;

/** An unsigned number in LEB128. */
function leb(value: number): number[] {
  return value < 128 ? [value] : [(value & 127) | 128, ...leb(value >>> 7)];
}

/** A signed number in LEB128. */
function signed(value: number): number[] {
  const rest = value >> 7;
  const isLast = (rest === 0 && (value & 64) === 0) || (rest === -1 && (value & 64) !== 0);
  return isLast ? [value & 127] : [(value & 127) | 128, ...signed(rest)];
}

const vector = (items: number[][]) => [...leb(items.length), ...items.flat()];
const text = (it: string) => [...leb(it.length), ...new TextEncoder().encode(it)];
const section = (id: number, content: number[]) => [id, ...leb(content.length), ...content];
const constant = (value: number) => [0x41, ...signed(value)];

/** The functions by name: their parameters, results and instructions. */
const FUNCTIONS: [string, number[], number[], number[]][] = [
  ["input", [I32], [I32], [0x20, 0, 0x24, 0, ...constant(PLACE)]],
  ["request", [], [], [0x23, 0, ...constant(MOST), 0x4b, 0x04, 0x40, 0x00, 0x0b]],
  ["output", [], [I32], constant(PLACE)],
  ["output_len", [], [I32], [0x23, 0]],
  [
    "column",
    [I32],
    [I32],
    [...constant(1), 0x40, 0, 0x1a, 0x20, 0, ...constant(1), 0x6a, ...constant(3), 0x74],
  ],
  ["ids", [], [I32], constant(64)],
  ["n", [], [I32], constant(1)],
];

/** Doubles 1 to 5 from 8 bytes on, and the id 7 at 64. */
const DATA = (() => {
  const bytes = new Uint8Array(68);
  const view = new DataView(bytes.buffer);
  for (let k = 1; k <= 5; k += 1) {
    view.setFloat64(8 * k, k, true);
  }
  view.setUint32(64, 7, true);
  return [...bytes];
})();

export const ECHO = new Uint8Array([
  ...[0, 0x61, 0x73, 0x6d, 1, 0, 0, 0],
  ...section(
    1,
    vector(
      FUNCTIONS.map(([, takes, gives]) => [
        0x60,
        ...vector(takes.map((it) => [it])),
        ...vector(gives.map((it) => [it])),
      ]),
    ),
  ),
  ...section(3, vector(FUNCTIONS.map((_, k) => [k]))),
  ...section(5, vector([[0, 1]])),
  ...section(6, vector([[I32, 1, ...constant(0), 0x0b]])),
  ...section(
    7,
    vector([[...text("memory"), 2, 0], ...FUNCTIONS.map(([name], k) => [...text(name), 0, k])]),
  ),
  ...section(
    10,
    vector(
      FUNCTIONS.map(([, , , body]) => {
        const whole = [0, ...body, 0x0b];
        return [...leb(whole.length), ...whole];
      }),
    ),
  ),
  ...section(11, vector([[0, ...constant(0), 0x0b, ...leb(DATA.length), ...DATA]])),
]);
