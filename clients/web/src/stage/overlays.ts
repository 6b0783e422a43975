/** What is drawn below and above the bodies. */
import { type Body, meetingPoint } from "../geometry/body.ts";
import type { Bodies } from "../geometry/touching.ts";
import { fillCapsules, MANY, NARROW_PX, stroke, trace } from "./bodies.ts";
import type { Camera } from "./camera.ts";
import { CLUSTERS, type Colours } from "./colours.ts";

const FONT = "600 12px system-ui, sans-serif";

/** A round number of body sizes, the least that takes so many pixels. */
export function roundLength(scale: number, least_px: number): number {
  const rough = least_px / scale;
  const power = 10 ** Math.floor(Math.log10(rough));
  const found = [1, 2, 5, 10].find((step) => step * power >= rough) ?? 10;
  return found * power;
}

/** Lines that stand still in the plane, so that a group that travels is seen to. */
export function drawGrid(g: CanvasRenderingContext2D, camera: Camera, colours: Colours): void {
  const spacing = roundLength(camera.scale, 70);
  const [left, top] = camera.toPlane(0, 0);
  const [right, bottom] = camera.toPlane(camera.width, camera.height);
  g.beginPath();
  for (let k = Math.ceil(left / spacing); k * spacing <= right; k += 1) {
    const x = Math.round(camera.toScreen(k * spacing, 0)[0]) + 0.5;
    g.moveTo(x, 0);
    g.lineTo(x, camera.height);
  }
  for (let k = Math.ceil(bottom / spacing); k * spacing <= top; k += 1) {
    const y = Math.round(camera.toScreen(0, k * spacing)[1]) + 0.5;
    g.moveTo(0, y);
    g.lineTo(camera.width, y);
  }
  g.lineCap = "butt";
  stroke(g, colours.grid, 1);
}

export function drawScaleBar(g: CanvasRenderingContext2D, camera: Camera, colours: Colours): void {
  const length = roundLength(camera.scale, 80);
  const [x, y] = [14, camera.height - 14];
  g.beginPath();
  g.moveTo(x + 0.5, y - 5);
  g.lineTo(x + 0.5, y);
  g.lineTo(x + length * camera.scale, y);
  g.lineTo(x + length * camera.scale, y - 5);
  g.lineCap = "butt";
  g.lineJoin = "miter";
  stroke(g, colours.ink, 2);
  g.font = FONT;
  g.textAlign = "left";
  g.textBaseline = "bottom";
  g.fillStyle = colours.ink;
  const rounded = Number(length.toPrecision(3));
  const text = `${rounded} body size${rounded === 1 ? "" : "s"}`;
  g.lineJoin = "round";
  g.strokeStyle = colours.paper;
  g.lineWidth = 4;
  g.strokeText(text, x + 5, y - 5);
  g.fillText(text, x + 5, y - 5);
}

/** A broad edge around each cluster, below its bodies. */
export function drawClusters(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  body: Body,
  clusters: number[][],
): void {
  g.lineCap = "round";
  const edge = Math.max(2, Math.min(7, 0.15 * camera.scale));
  const width = 2 * (body.radius * camera.scale + edge);
  const simply = bodies.x.length > MANY && width < 2 * NARROW_PX;
  clusters.forEach((cluster, k) => {
    if (simply) {
      g.fillStyle = CLUSTERS[k % CLUSTERS.length]!;
      fillCapsules(g, camera, bodies, body, cluster, width / 2);
      return;
    }
    trace(g, camera, bodies, cluster, -body.half_length, body.half_length + 1e-6);
    stroke(g, CLUSTERS[k % CLUSTERS.length]!, width);
  });
}

/** More would hide the bodies; all clusters have an edge. */
const MOST_LABELS = 40;

/** The clusters' numbers above them, the largest being 1, and how many members each has. */
export function labelClusters(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  clusters: number[][],
  colours: Colours,
): void {
  g.font = FONT;
  g.textAlign = "center";
  g.textBaseline = "middle";
  const taken: [number, number, number][] = [];
  clusters.slice(0, MOST_LABELS).forEach((cluster, k) => {
    let x = 0;
    let y = Number.NEGATIVE_INFINITY;
    for (const i of cluster) {
      x += bodies.x[i]! / cluster.length;
      y = Math.max(y, bodies.y[i]!);
    }
    const [left, foot] = camera.toScreen(x, y);
    const top = foot - 12 - 0.5 * camera.scale;
    const text = cluster.length > 2 ? `${k + 1}: ${cluster.length}` : `${k + 1}`;
    const wide = g.measureText(text).width + 10;
    // Of labels that would overlap the larger cluster's stays.
    const hides = taken.some(([x, y, half]) => {
      return Math.abs(x - left) < half + wide / 2 + 2 && Math.abs(y - top) < 20;
    });
    if (hides) {
      return;
    }
    taken.push([left, top, wide / 2]);
    g.beginPath();
    g.roundRect(left - wide / 2, top - 9, wide, 18, 9);
    g.fillStyle = colours.ink;
    g.fill();
    g.strokeStyle = CLUSTERS[k % CLUSTERS.length]!;
    g.lineWidth = 2;
    g.stroke();
    g.fillStyle = colours.label;
    g.fillText(text, left, top + 0.5);
  });
}

/** Of more contacts than this each is a square between the centres, which is filled quickly. */
const MANY_CONTACTS = 300;

function drawDots(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  pairs: Uint32Array,
  size: number,
  colours: Colours,
): void {
  g.fillStyle = colours.contact;
  for (let k = 0; k < pairs.length; k += 2) {
    const [i, j] = [pairs[k]!, pairs[k + 1]!];
    const x = (bodies.x[i]! + bodies.x[j]!) / 2;
    const y = (bodies.y[i]! + bodies.y[j]!) / 2;
    const [left, top] = camera.toScreen(x, y);
    g.fillRect(left - size / 2, top - size / 2, size, size);
  }
}

/** A diamond where two bodies touch. */
export function drawContacts(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  body: Body,
  pairs: Uint32Array,
  colours: Colours,
): void {
  const size = Math.max(3, Math.min(7, 0.16 * camera.scale));
  if (pairs.length > 2 * MANY_CONTACTS) {
    drawDots(g, camera, bodies, pairs, size, colours);
    return;
  }
  g.beginPath();
  for (let k = 0; k < pairs.length; k += 2) {
    const [i, j] = [pairs[k]!, pairs[k + 1]!];
    const dx = bodies.x[j]! - bodies.x[i]!;
    const dy = bodies.y[j]! - bodies.y[i]!;
    const [mx, my] = meetingPoint(dx, dy, bodies.alpha[i]!, bodies.alpha[j]!, body);
    const [x, y] = camera.toScreen(bodies.x[i]! + mx, bodies.y[i]! + my);
    g.moveTo(x - size, y);
    g.lineTo(x, y - size);
    g.lineTo(x + size, y);
    g.lineTo(x, y + size);
    g.closePath();
  }
  g.lineJoin = "miter";
  stroke(g, colours.contact_edge, 3);
  g.fillStyle = colours.contact;
  g.fill();
}

/** A red line for each vector x, y, x, y, …, from the individual it belongs to; of a length of one
 * body it has so many pixels at least, but no more than three bodies'. */
const LEAST_VECTOR_PX = 18;

export function drawVectors(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  which: ArrayLike<number>,
  vectors: Float64Array,
  colours: Colours,
): void {
  // From far off they are not to hide the bodies.
  const scale = Math.max(camera.scale, Math.min(LEAST_VECTOR_PX, 3 * camera.scale));
  const many = which.length > MANY;
  g.lineCap = many ? "butt" : "round";
  g.strokeStyle = colours.wish;
  g.lineWidth = Math.max(1.5, Math.min(3, 0.06 * camera.scale));
  g.beginPath();
  for (let k = 0; k < which.length; k += 1) {
    const i = which[k]!;
    const [x, y] = camera.toScreen(bodies.x[i]!, bodies.y[i]!);
    g.moveTo(x, y);
    g.lineTo(x + vectors[2 * i]! * scale, y - vectors[2 * i + 1]! * scale);
    if (many) {
      // A path of many lines takes longer than many of one.
      g.stroke();
      g.beginPath();
    }
  }
  if (!many) {
    // A pale rim, since red on blue and orange is told apart badly.
    const width = g.lineWidth;
    stroke(g, colours.paper, width + 2);
    stroke(g, colours.wish, width);
  }
}

/** A broad edge around those who are selected. */
export function drawSelected(
  g: CanvasRenderingContext2D,
  camera: Camera,
  bodies: Bodies,
  body: Body,
  which: number[],
  colours: Colours,
): void {
  g.lineCap = "round";
  trace(g, camera, bodies, which, -body.half_length, body.half_length + 1e-6);
  const width = 2 * body.radius * camera.scale;
  stroke(g, colours.selected, width + 8);
  stroke(g, colours.paper, width + 3);
}

/** The lasso while it is drawn, in pixels x, y, x, y, …. */
export function drawLasso(
  g: CanvasRenderingContext2D,
  line: ArrayLike<number>,
  colours: Colours,
): void {
  g.beginPath();
  for (let k = 0; k < line.length; k += 2) {
    g.lineTo(line[k]!, line[k + 1]!);
  }
  g.closePath();
  g.globalAlpha = 0.12;
  g.fillStyle = colours.selected;
  g.fill();
  g.globalAlpha = 1;
  g.setLineDash([6, 4]);
  stroke(g, colours.selected, 2);
  g.setLineDash([]);
}

/** The arrow of a direction that is being dragged. */
export function drawArrow(
  g: CanvasRenderingContext2D,
  from: readonly [number, number],
  to: readonly [number, number],
  colours: Colours,
): void {
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  g.beginPath();
  g.moveTo(...from);
  g.lineTo(...to);
  for (const side of [-0.45, 0.45]) {
    g.moveTo(...to);
    g.lineTo(to[0] - 16 * Math.cos(angle + side), to[1] - 16 * Math.sin(angle + side));
  }
  g.lineCap = "round";
  stroke(g, colours.paper, 7);
  stroke(g, colours.wish, 4);
}
