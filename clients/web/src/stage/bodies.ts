/**
 * Bodies: capsules with a marked head, in one of two looks.
 *
 * A few are drawn as the Python package draws them, with an edge. Many small ones are one polygon
 * each, a little slimmer so that neighbours stay apart, with a dark tip: without a GPU a browser
 * fills about 1000 of those in 10 ms, and of paths with round ends a third.
 */
import type { Body } from "../geometry/body.ts";
import type { Bodies } from "../geometry/touching.ts";
import type { Camera } from "./camera.ts";

/** With more than this many in sight, and bodies narrower than this, they are drawn simply. */
export const MANY = 250;
export const NARROW_PX = 16;
const EDGE_PX = 1.3;
/** However far off, a body is seen. */
const LEAST_PX = 2;

export interface Look {
  fill: string;
  edge: string;
}

/** The indices of bodies of which something may be seen. */
export function inSight(bodies: Bodies, camera: Camera): Uint32Array {
  const reach_x = camera.width / 2 / camera.scale + 1;
  const reach_y = camera.height / 2 / camera.scale + 1;
  const found = new Uint32Array(bodies.x.length);
  let count = 0;
  for (let i = 0; i < bodies.x.length; i += 1) {
    const far_x = Math.abs(bodies.x[i]! - camera.x);
    const far_y = Math.abs(bodies.y[i]! - camera.y);
    if (far_x <= reach_x && far_y <= reach_y) {
      found[count] = i;
      count += 1;
    }
  }
  return found.subarray(0, count);
}

export function drawBodies(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  body: Body,
  which: ArrayLike<number>,
  look: Look,
  of_all: number,
): void {
  const width = Math.max(2 * body.radius * camera.scale, LEAST_PX);
  if (of_all > MANY && width < NARROW_PX) {
    drawSimply(g, camera, bodies, body, which, look);
    return;
  }
  g.lineCap = "round";
  const slender = Math.min(1, body.half_length / body.radius);
  trace(g, camera, bodies, which, -body.half_length, body.half_length);
  stroke(g, look.edge, width);
  stroke(g, look.fill, Math.max(width - 2 * EDGE_PX, 0.55 * width));
  const at = body.half_length + (0.45 - 0.3 * slender) * body.radius;
  trace(g, camera, bodies, which, at, at);
  stroke(g, look.edge, (0.42 + 0.18 * slender) * width);
}

/** Makes lines along some bodies, between two places on their axes. */
export function trace(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  which: ArrayLike<number>,
  from: number,
  to: number,
): void {
  g.beginPath();
  for (let k = 0; k < which.length; k += 1) {
    const i = which[k]!;
    const [x, y] = camera.toScreen(bodies.x[i]!, bodies.y[i]!);
    const c = Math.cos(bodies.alpha[i]!) * camera.scale;
    const s = -Math.sin(bodies.alpha[i]!) * camera.scale;
    g.moveTo(x + from * c, y + from * s);
    // A line of no length has no ends to round off.
    g.lineTo(x + to * c + (from === to ? 0.01 : 0), y + to * s);
  }
}

export function stroke(g: CanvasRenderingContext2D, colour: string, width: number): void {
  g.strokeStyle = colour;
  g.lineWidth = width;
  g.stroke();
}

const DIAGONAL = Math.SQRT1_2;

/** Fills a polygon for each of some bodies, with a radius in pixels. */
export function fillCapsules(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  body: Body,
  which: ArrayLike<number>,
  radius: number,
): void {
  const { scale } = camera;
  const half = body.half_length * scale;
  const near = DIAGONAL * radius;
  const middle_x = camera.width / 2 - camera.x * scale;
  const middle_y = camera.height / 2 + camera.y * scale;
  for (let k = 0; k < which.length; k += 1) {
    const i = which[k]!;
    const c = Math.cos(bodies.alpha[i]!);
    const s = -Math.sin(bodies.alpha[i]!);
    let x = middle_x + bodies.x[i]! * scale + half * c;
    let y = middle_y - bodies.y[i]! * scale + half * s;
    g.beginPath();
    g.moveTo(x - radius * s, y + radius * c);
    g.lineTo(x + near * (c - s), y + near * (s + c));
    g.lineTo(x + radius * c, y + radius * s);
    g.lineTo(x + near * (c + s), y + near * (s - c));
    g.lineTo(x + radius * s, y - radius * c);
    x -= 2 * half * c;
    y -= 2 * half * s;
    g.lineTo(x + radius * s, y - radius * c);
    g.lineTo(x - near * (c - s), y - near * (s + c));
    g.lineTo(x - radius * c, y - radius * s);
    g.lineTo(x - near * (c + s), y - near * (s - c));
    g.lineTo(x - radius * s, y + radius * c);
    g.fill();
  }
}

function drawSimply(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  body: Body,
  which: ArrayLike<number>,
  look: Look,
): void {
  const { scale } = camera;
  const half = body.half_length * scale;
  const radius = Math.max(0.7, body.radius * scale - 0.4);
  const middle_x = camera.width / 2 - camera.x * scale;
  const middle_y = camera.height / 2 + camera.y * scale;
  g.fillStyle = look.fill;
  fillCapsules(g, camera, bodies, body, which, radius);
  const side = Math.max(1.4, 1.1 * radius);
  const ahead = half + (half > 0 ? 0.1 : 0.4) * radius;
  g.fillStyle = look.edge;
  for (let k = 0; k < which.length; k += 1) {
    const i = which[k]!;
    const x = middle_x + bodies.x[i]! * scale + ahead * Math.cos(bodies.alpha[i]!);
    const y = middle_y - bodies.y[i]! * scale - ahead * Math.sin(bodies.alpha[i]!);
    g.fillRect(x - side / 2, y - side / 2, side, side);
  }
}
