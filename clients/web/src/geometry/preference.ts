/** The preference vectors of the paper, eq. (3) and (4), with the attraction towards all others. */
import type { Bodies } from "./touching.ts";

/**
 * `p / c_s` of each individual: the mean of the unit vectors to all the others, and its own
 * direction times its weight if it is informed. As x, y, x, y, ….
 */
export function preferences(
  bodies: Bodies,
  weight: Float64Array,
  direction: Float64Array,
): Float64Array {
  const n = bodies.x.length;
  const found = new Float64Array(2 * n);
  for (let i = 0; i < n; i += 1) {
    for (let j = i + 1; j < n; j += 1) {
      const dx = bodies.x[j]! - bodies.x[i]!;
      const dy = bodies.y[j]! - bodies.y[i]!;
      const far = Math.sqrt(dx * dx + dy * dy);
      if (far > 0) {
        const x = dx / far / (n - 1);
        const y = dy / far / (n - 1);
        found[2 * i]! += x;
        found[2 * i + 1]! += y;
        found[2 * j]! -= x;
        found[2 * j + 1]! -= y;
      }
    }
  }
  for (let i = 0; i < n; i += 1) {
    if (weight[i]! > 0) {
      found[2 * i]! += weight[i]! * Math.cos(direction[i]!);
      found[2 * i + 1]! += weight[i]! * Math.sin(direction[i]!);
    }
  }
  return found;
}
