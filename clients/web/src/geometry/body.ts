/** The body: a segment of half-length `half_length`, swept by a disc of `radius`. */

export interface Body {
  half_length: number;
  radius: number;
}

/** The body whose length is `pi1` times its width, the mean of both being 1. */
export function bodyOf(pi1: number): Body {
  const radius = 1 / (1 + pi1);
  return { half_length: (pi1 - 1) * radius, radius };
}

/** The free speed: lengths are in body sizes, times in body sizes over the free speed. */
const FREE_SPEED = 1;

/** The time units in which a body that nothing touches moves by half its length. */
export function halfLengthTime({ half_length, radius }: Body): number {
  return (half_length + radius) / FREE_SPEED;
}

/** The squared distance of the point (px, py) from the segment about (x, y) along (c, s). */
export function squaredDistance(
  px: number,
  py: number,
  x: number,
  y: number,
  c: number,
  s: number,
  half: number,
): number {
  const dx = px - x;
  const dy = py - y;
  const along = Math.max(-half, Math.min(half, dx * c + dy * s));
  const ex = dx - along * c;
  const ey = dy - along * s;
  return ex * ex + ey * ey;
}

/** Whether two segments of half-length `half`, about the origin and about (dx, dy), cross. */
function cross(
  dx: number,
  dy: number,
  ci: number,
  si: number,
  cj: number,
  sj: number,
  half: number,
): boolean {
  const det = ci * sj - si * cj;
  if (det === 0) {
    return false;
  }
  const t = (dx * sj - dy * cj) / det;
  const u = (dx * si - dy * ci) / det;
  return Math.abs(t) < half && Math.abs(u) < half;
}

/**
 * The gap between two bodies, the second at (dx, dy) from the first: the signed distance of their
 * surfaces. Two segments that do not cross are nearest at an endpoint of one of them.
 */
export function gap(dx: number, dy: number, alphaI: number, alphaJ: number, body: Body): number {
  const half = body.half_length;
  const [ci, si] = [Math.cos(alphaI), Math.sin(alphaI)];
  const [cj, sj] = [Math.cos(alphaJ), Math.sin(alphaJ)];
  if (cross(dx, dy, ci, si, cj, sj, half)) {
    return -2 * body.radius;
  }
  const [hi, ki, hj, kj] = [half * ci, half * si, half * cj, half * sj];
  const least = Math.min(
    squaredDistance(hi, ki, dx, dy, cj, sj, half),
    squaredDistance(-hi, -ki, dx, dy, cj, sj, half),
    squaredDistance(dx + hj, dy + kj, 0, 0, ci, si, half),
    squaredDistance(dx - hj, dy - kj, 0, 0, ci, si, half),
  );
  return Math.sqrt(least) - 2 * body.radius;
}

/** Where two bodies are nearest: the middle between their axes there, from the first's centre. */
export function meetingPoint(
  dx: number,
  dy: number,
  alphaI: number,
  alphaJ: number,
  body: Body,
): [number, number] {
  const half = body.half_length;
  const [ci, si] = [Math.cos(alphaI), Math.sin(alphaI)];
  const [cj, sj] = [Math.cos(alphaJ), Math.sin(alphaJ)];
  let least = Number.POSITIVE_INFINITY;
  let sum: [number, number] = [0, 0];
  let ties = 0;
  const consider = (px: number, py: number, x: number, y: number, c: number, s: number) => {
    const along = Math.max(-half, Math.min(half, (px - x) * c + (py - y) * s));
    const qx = x + along * c;
    const qy = y + along * s;
    const far = Math.hypot(px - qx, py - qy);
    const middle: [number, number] = [(px + qx) / 2, (py + qy) / 2];
    // Bodies side by side meet along a line: the mean of the equally near points is its middle.
    if (far < least - 1e-6) {
      [least, sum, ties] = [far, middle, 1];
    } else if (far < least + 1e-6) {
      sum = [sum[0] + middle[0], sum[1] + middle[1]];
      ties += 1;
    }
  };
  for (const sign of half > 0 ? [1, -1] : [1]) {
    consider(sign * half * ci, sign * half * si, dx, dy, cj, sj);
    consider(dx + sign * half * cj, dy + sign * half * sj, 0, 0, ci, si);
  }
  return [sum[0] / ties, sum[1] / ties];
}
