/** The bodies that a lasso encloses, and the body at a point. */
import { type Body, squaredDistance } from "./body.ts";
import type { Bodies } from "./touching.ts";

/** Whether (x, y) is inside the polygon x, y, x, y, …, by the even-odd rule. */
export function encloses(polygon: ArrayLike<number>, x: number, y: number): boolean {
  let inside = false;
  const last = polygon.length - 2;
  for (let k = 0, p = last; k <= last; p = k, k += 2) {
    const [ax, ay] = [polygon[k]!, polygon[k + 1]!];
    const [bx, by] = [polygon[p]!, polygon[p + 1]!];
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) {
      inside = !inside;
    }
  }
  return inside;
}

/** The indices of the bodies whose centre is inside the polygon. */
export function enclosed(polygon: ArrayLike<number>, bodies: Bodies): number[] {
  const found: number[] = [];
  if (polygon.length < 6) {
    return found;
  }
  for (let i = 0; i < bodies.x.length; i += 1) {
    if (encloses(polygon, bodies.x[i]!, bodies.y[i]!)) {
      found.push(i);
    }
  }
  return found;
}

/** The index of the body nearest to (x, y); null if all are further away than `reach`. */
export function nearest(
  bodies: Bodies,
  body: Body,
  x: number,
  y: number,
  reach: number,
): number | null {
  let found: number | null = null;
  let least = (body.radius + reach) ** 2;
  for (let i = 0; i < bodies.x.length; i += 1) {
    const c = Math.cos(bodies.alpha[i]!);
    const s = Math.sin(bodies.alpha[i]!);
    const far = squaredDistance(x, y, bodies.x[i]!, bodies.y[i]!, c, s, body.half_length);
    if (far <= least) {
      least = far;
      found = i;
    }
  }
  return found;
}
