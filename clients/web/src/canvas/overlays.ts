/** The layers below and above the bodies. */

import { meetingPoint } from "../geometry/body.ts";
import { ORIGIN_UNIT, type Origin } from "../wire/state.ts";
import { fillCapsules, MANY, NARROW_PX, type Scene, stroke, trace } from "./bodies.ts";
import { CLUSTERS } from "./colours.ts";

/** The ring of headings: its centre is `far` from two edges. */
const RING = { far: 30, radius: 13, width: 9 };
const FONT = "600 12px system-ui, sans-serif";

/** The least round number of body sizes that spans at least `least_px` pixels. */
export function roundLength(scale: number, least_px: number): number {
  const rough = least_px / scale;
  const power = 10 ** Math.floor(Math.log10(rough));
  const found = [1, 2, 5, 10].find((step) => step * power >= rough) ?? 10;
  return found * power;
}

/** Grid lines fixed in the plane, whatever the origin of the positions: they show that a followed
 * group moves. */
export function drawGrid({ g, camera, colours }: Scene, origin: Origin): void {
  const spacing = roundLength(camera.scale, 70);
  const [left, top] = camera.toPlane(0, 0);
  const [right, bottom] = camera.toPlane(camera.width, camera.height);
  // The first line above the origin; both lengths are small beside its distance from (0, 0).
  const [first_x, first_y] = origin.map((it) => -((it * ORIGIN_UNIT) % spacing)) as [
    number,
    number,
  ];
  g.beginPath();
  for (let k = Math.ceil((left - first_x) / spacing); first_x + k * spacing <= right; k += 1) {
    const x = Math.round(camera.toScreen(first_x + k * spacing, 0)[0]) + 0.5;
    g.moveTo(x, 0);
    g.lineTo(x, camera.height);
  }
  for (let k = Math.ceil((bottom - first_y) / spacing); first_y + k * spacing <= top; k += 1) {
    const y = Math.round(camera.toScreen(0, first_y + k * spacing)[1]) + 0.5;
    g.moveTo(0, y);
    g.lineTo(camera.width, y);
  }
  g.lineCap = "butt";
  stroke(g, colours.grid, 1);
}

/** Draws the colours of the headings as a ring, at the top left. */
export function drawHeadings({ g, colours }: Scene): void {
  const { headings } = colours;
  const part = (2 * Math.PI) / headings.length;
  const [x, y] = [RING.far, RING.far];
  headings.forEach(({ fill }, k) => {
    g.beginPath();
    // The screen's y axis points down; the slight overlap leaves no seams.
    g.arc(x, y, RING.radius, -(k + 0.53) * part, -(k - 0.53) * part);
    g.lineCap = "butt";
    stroke(g, fill, RING.width);
  });
  g.fillStyle = colours.ink;
  g.font = FONT;
  g.textAlign = "left";
  g.textBaseline = "middle";
  g.fillText("heading", x + RING.far, y);
}

export function drawScaleBar({ g, camera, colours }: Scene): void {
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

/** An outline around each cluster, below its bodies. */
export function drawClusters(scene: Scene, clusters: number[][]): void {
  const { g, camera, bodies, body } = scene;
  g.lineCap = "round";
  const edge = Math.max(2, Math.min(7, 0.15 * camera.scale));
  const width = 2 * (body.radius * camera.scale + edge);
  const polygons = bodies.x.length > MANY && width < 2 * NARROW_PX;
  clusters.forEach((cluster, k) => {
    if (polygons) {
      g.fillStyle = CLUSTERS[k % CLUSTERS.length]!;
      fillCapsules(scene, cluster, width / 2);
      return;
    }
    trace(scene, cluster, -body.half_length, body.half_length + 1e-6);
    stroke(g, CLUSTERS[k % CLUSTERS.length]!, width);
  });
}

/** More labels would hide the bodies; all clusters have an outline. */
const MAX_LABELS = 40;

/** Labels above the clusters: the rank by size, and the number of members if more than two. */
export function labelClusters({ g, camera, bodies, colours }: Scene, clusters: number[][]): void {
  g.font = FONT;
  g.textAlign = "center";
  g.textBaseline = "middle";
  const taken: [number, number, number][] = [];
  clusters.slice(0, MAX_LABELS).forEach((cluster, k) => {
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
    // Of overlapping labels only the larger cluster's is drawn.
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

/** More contacts than this are drawn as squares between the centres, which fill faster. */
const MANY_CONTACTS = 300;

function drawDots({ g, camera, bodies, colours }: Scene, pairs: Uint32Array, size: number): void {
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
export function drawContacts(scene: Scene, pairs: Uint32Array): void {
  const { g, camera, bodies, body, colours } = scene;
  const size = Math.max(3, Math.min(7, 0.16 * camera.scale));
  if (pairs.length > 2 * MANY_CONTACTS) {
    drawDots(scene, pairs, size);
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

/** The minimum length in pixels of a vector of length one, but at most three body sizes. */
const MIN_VECTOR_PX = 18;

/** Draws vectors x, y, x, y, … as red lines from their individuals. */
export function drawVectors(
  { g, camera, bodies, colours }: Scene,
  which: ArrayLike<number>,
  vectors: Float64Array,
): void {
  // At small scales longer vectors would hide the bodies.
  const scale = Math.max(camera.scale, Math.min(MIN_VECTOR_PX, 3 * camera.scale));
  const many = which.length > MANY;
  g.lineCap = many ? "butt" : "round";
  g.strokeStyle = colours.preference;
  g.lineWidth = Math.max(1.5, Math.min(3, 0.06 * camera.scale));
  g.beginPath();
  for (let k = 0; k < which.length; k += 1) {
    const i = which[k]!;
    const [x, y] = camera.toScreen(bodies.x[i]!, bodies.y[i]!);
    g.moveTo(x, y);
    g.lineTo(x + vectors[2 * i]! * scale, y - vectors[2 * i + 1]! * scale);
    if (many) {
      // One path of many lines is slower than many paths of one line.
      g.stroke();
      g.beginPath();
    }
  }
  if (!many) {
    // A pale outline: red on blue or orange has little contrast.
    const width = g.lineWidth;
    stroke(g, colours.paper, width + 2);
    stroke(g, colours.preference, width);
  }
}

/** An outline around the selected bodies. */
export function drawSelected(scene: Scene, which: number[]): void {
  const { g, camera, body, colours } = scene;
  g.lineCap = "round";
  trace(scene, which, -body.half_length, body.half_length + 1e-6);
  const width = 2 * body.radius * camera.scale;
  stroke(g, colours.selected, width + 8);
  stroke(g, colours.paper, width + 3);
}

/** The lasso while it is drawn; its points in pixels, x, y, …. */
export function drawLasso({ g, colours }: Scene, line: ArrayLike<number>): void {
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
  { g, colours }: Scene,
  from: readonly [number, number],
  to: readonly [number, number],
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
  stroke(g, colours.preference, 4);
}
