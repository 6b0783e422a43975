/** Encodes frames as `jostle export` does, for tests of the player. */
import { gzipSync } from "node:zlib";
import type { StoredFrames } from "../src/player/file.ts";

export interface Poses {
  step: number;
  id: number[];
  informed: boolean[];
  /** Quantised. */
  x: number[];
  y: number[];
  alpha: number[];
}

function unsigned(value: number): number[] {
  return value < 128 ? [value] : [(value % 128) + 128, ...unsigned(Math.floor(value / 128))];
}

const signed = (value: number) => unsigned(value < 0 ? -2 * value - 1 : 2 * value);

export function encodeFrames(frames: readonly Poses[]): Uint8Array {
  const bytes: number[] = [];
  frames.forEach((frame, k) => {
    const [one, two] = [frames[k - 1], frames[k - 2]];
    const isSame = (it: Poses | undefined) =>
      JSON.stringify([it?.id, it?.informed]) === JSON.stringify([frame.id, frame.informed]);
    bytes.push(...signed(frame.step - (one?.step ?? 0)));
    if (isSame(one)) {
      bytes.push(0);
    } else {
      bytes.push(...unsigned(frame.id.length + 1));
      frame.id.forEach((id, i) => {
        bytes.push(...signed(id - (frame.id[i - 1] ?? 0)));
      });
      bytes.push(...frame.informed.map(Number));
    }
    for (const name of ["x", "y", "alpha"] as const) {
      frame.id.forEach((id, i) => {
        const of = (it: Poses | undefined) => it?.[name][it.id.indexOf(id)];
        const [last, before] = [of(one), of(two)];
        const predicted = last === undefined ? 0 : before === undefined ? last : 2 * last - before;
        bytes.push(...signed(frame[name][i]! - predicted));
      });
    }
  });
  return Uint8Array.from(bytes);
}

/** Frames as a file has them. */
export function storeFrames(frames: readonly Poses[], pi1: [number, number][]): StoredFrames {
  const data = gzipSync(encodeFrames(frames)).toString("base64");
  return { count: frames.length, dt: 0.02, quantum: 0.01, turn: 1024, pi1, data };
}
