/** One picture, from below to above. */
import { type Body, halfLengthTime } from "../geometry/body.ts";
import type { Bodies } from "../geometry/touching.ts";
import type { State } from "../wire/state.ts";
import { drawBodies, inSight } from "./bodies.ts";
import type { Camera } from "./camera.ts";
import type { Colours } from "./colours.ts";
import * as overlays from "./overlays.ts";
import type { Trails } from "./trails.ts";

/** What is to be seen besides the bodies. */
export interface Shows {
  contacts: boolean;
  clusters: boolean;
  trails: boolean;
  preferences: boolean;
}

export interface Picture {
  state: State;
  bodies: Bodies;
  body: Body;
  shows: Shows;
  trails: Trails;
  pairs: Uint32Array;
  clusters: number[][];
  /** Vectors of everybody, if asked for. */
  preferences: Float64Array | null;
  /** Indices. */
  selected: number[];
  lasso: number[] | null;
  arrow: [[number, number], [number, number]] | null;
}

export function paint(
  g: CanvasRenderingContext2D,
  camera: Camera,
  colours: Colours,
  picture: Picture,
): void {
  const { state, bodies, body, shows } = picture;
  g.fillStyle = colours.paper;
  g.fillRect(0, 0, camera.width, camera.height);
  overlays.drawGrid(g, camera, colours);
  if (shows.trails) {
    picture.trails.draw(g, camera, colours.trail, halfLengthTime(body));
  }
  if (shows.clusters) {
    overlays.drawClusters(g, camera, bodies, body, picture.clusters);
  }
  const visible = inSight(bodies, camera);
  if (picture.selected.length > 0) {
    overlays.drawSelected(g, camera, bodies, body, picture.selected, colours);
  }
  const plain = visible.filter((i) => !(state.weight[i]! > 0));
  const informed = visible.filter((i) => state.weight[i]! > 0);
  drawBodies(g, camera, bodies, body, plain, colours.plain, visible.length);
  drawBodies(g, camera, bodies, body, informed, colours.informed, visible.length);
  if (picture.preferences) {
    overlays.drawVectors(g, camera, bodies, visible, picture.preferences, colours);
  } else if (informed.length > 0) {
    overlays.drawVectors(g, camera, bodies, informed, directions(state), colours);
  }
  if (shows.contacts) {
    overlays.drawContacts(g, camera, bodies, body, picture.pairs, colours);
  }
  if (shows.clusters) {
    overlays.labelClusters(g, camera, bodies, picture.clusters, colours);
  }
  overlays.drawScaleBar(g, camera, colours);
  if (picture.lasso) {
    overlays.drawLasso(g, picture.lasso, colours);
  }
  if (picture.arrow) {
    overlays.drawArrow(g, ...picture.arrow, colours);
  }
}

/** A line as long as a body for the preferred direction of each. */
function directions(state: State): Float64Array {
  const found = new Float64Array(2 * state.id.length);
  state.direction.forEach((direction, i) => {
    found[2 * i] = 1.1 * Math.cos(direction);
    found[2 * i + 1] = 1.1 * Math.sin(direction);
  });
  return found;
}
