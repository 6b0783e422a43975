/**
 * Draws bodies as capsules with a marked head, in one of two styles.
 *
 * A few bodies are drawn with an edge, as by the Python package. Many small ones are one polygon
 * each with a dark tip, slightly slimmer so that neighbours stay distinct: without a GPU a browser
 * fills about 1000 of those in 10 ms, and a third as many paths with round ends.
 */
import type { Body } from "../geometry/body.ts";
import type { Bodies } from "../geometry/touching.ts";
import type { Drawn } from "../wire/state.ts";
import type { Camera } from "./camera.ts";
import type { Colours, Look } from "./colours.ts";

/** More than this many visible bodies, narrower than this, are drawn as polygons. */
export const MANY = 250;
export const NARROW_PX = 16;
const EDGE_PX = 1.3;
/** The minimum width of a body on the screen. */
const MIN_PX = 2;
/** The minimum of half a cross on the screen. */
const MIN_CROSS_PX = 2.5;

/** The bodies of a picture, and where and how they are drawn. */
export interface Scene {
  g: CanvasRenderingContext2D;
  camera: Camera;
  bodies: Bodies;
  body: Body;
  colours: Colours;
}

/** Clears the picture. */
export function clear({ g, camera, colours }: Omit<Scene, "bodies" | "body">): void {
  g.fillStyle = colours.paper;
  g.fillRect(0, 0, camera.width, camera.height);
}

/** The indices of bodies that may be visible. */
export function visibleBodies({ bodies, camera }: Scene): Uint32Array {
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

/** Draws some bodies, the informed ones above the others; returns the indices of the informed. Those
 * of a faulted swarm are hollow and crossed out: they differ from others without colours, too. */
export function drawBodies(
  scene: Scene,
  { weight, phase }: Pick<Drawn, "weight" | "phase">,
  which: Uint32Array,
  headings = false,
): Uint32Array {
  const informed = which.filter((i) => weight[i]! > 0);
  const plain = which.filter((i) => !(weight[i]! > 0));
  const width = Math.max(2 * scene.body.radius * scene.camera.scale, MIN_PX);
  if (phase === "faulted") {
    drawCapsules(scene, plain, scene.colours.faulted, width);
    drawCapsules(scene, informed, scene.colours.faulted_informed, width);
    drawCrosses(scene, which, Math.max(0.42 * width, MIN_CROSS_PX));
    return informed;
  }
  const draw = which.length > MANY && width < NARROW_PX ? drawPolygons : drawCapsules;
  for (const part of [plain, informed]) {
    if (headings) {
      for (const [{ fill, edge }, some] of byHeading(scene, part)) {
        const look = { fill, edge: part === informed ? scene.colours.ink : edge };
        draw(scene, some, look, width);
      }
    } else {
      draw(scene, part, part === plain ? scene.colours.plain : scene.colours.informed, width);
    }
  }
  return informed;
}

/** The bodies of each range of headings that has some, with its look. */
function byHeading({ bodies, colours }: Scene, which: Uint32Array): [Look, Uint32Array][] {
  const { headings } = colours;
  const range = (i: number) => headingRange(bodies.alpha[i]!, headings.length);
  return headings.flatMap((look, k): [Look, Uint32Array][] => {
    const some = which.filter((i) => range(i) === k);
    return some.length > 0 ? [[look, some]] : [];
  });
}

/** The index of the range of headings, of `ranges` equal ones about 0, in which a heading is. */
export function headingRange(alpha: number, ranges: number): number {
  const turns = alpha / (2 * Math.PI);
  return Math.round((turns - Math.floor(turns)) * ranges) % ranges;
}

function drawCapsules(scene: Scene, which: Uint32Array, look: Look, width: number): void {
  const { g, body } = scene;
  g.lineCap = "round";
  const slender = Math.min(1, body.half_length / body.radius);
  trace(scene, which, -body.half_length, body.half_length);
  stroke(g, look.edge, width);
  stroke(g, look.fill, Math.max(width - 2 * EDGE_PX, 0.55 * width));
  const at = body.half_length + (0.45 - 0.3 * slender) * body.radius;
  trace(scene, which, at, at);
  stroke(g, look.edge, (0.42 + 0.18 * slender) * width);
}

/** Draws a cross on the centre of each of some bodies. */
function drawCrosses({ g, camera, bodies, colours }: Scene, which: Uint32Array, size: number) {
  g.lineCap = "butt";
  g.beginPath();
  for (const i of which) {
    const [x, y] = camera.toScreen(bodies.x[i]!, bodies.y[i]!);
    g.moveTo(x - size, y - size);
    g.lineTo(x + size, y + size);
    g.moveTo(x - size, y + size);
    g.lineTo(x + size, y - size);
  }
  stroke(g, colours.faulted.edge, EDGE_PX);
}

/** Adds lines along the axes of some bodies to the path, between two offsets from the centre. */
export function trace(
  { g, camera, bodies }: Scene,
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
    // A line of length zero gets no round caps.
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
  { g, camera, bodies, body }: Scene,
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

function drawPolygons(scene: Scene, which: Uint32Array, look: Look): void {
  const { g, camera, bodies, body } = scene;
  const { scale } = camera;
  const half = body.half_length * scale;
  const radius = Math.max(0.7, body.radius * scale - 0.4);
  const middle_x = camera.width / 2 - camera.x * scale;
  const middle_y = camera.height / 2 + camera.y * scale;
  g.fillStyle = look.fill;
  fillCapsules(scene, which, radius);
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
