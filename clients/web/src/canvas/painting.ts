/** Draws one picture, from the bottom layer to the top. */
import { halfLengthTime } from "../geometry/body.ts";
import type { Drawn } from "../wire/state.ts";
import { clear, drawBodies, type Scene, visibleBodies } from "./bodies.ts";
import * as overlays from "./overlays.ts";
import type { Trails } from "./trails.ts";

/** The layers that are drawn in addition to the bodies. */
export interface Layers {
  /** The colour of a body is that of its heading. */
  headings: boolean;
  contacts: boolean;
  clusters: boolean;
  trails: boolean;
  preferences: boolean;
}

export interface Picture {
  state: Drawn;
  layers: Layers;
  trails: Trails;
  pairs: Uint32Array;
  clusters: number[][];
  /** The preference vector of each individual, if that layer is shown. */
  preferences: Float64Array | null;
  /** Indices. */
  selected: number[];
  lasso: number[] | null;
  arrow: [[number, number], [number, number]] | null;
}

export function paint(scene: Scene, picture: Picture): void {
  const { state, layers } = picture;
  clear(scene);
  overlays.drawGrid(scene, state.origin);
  if (layers.trails) {
    picture.trails.draw(scene, halfLengthTime(scene.body));
  }
  if (layers.clusters) {
    overlays.drawClusters(scene, picture.clusters);
  }
  if (picture.selected.length > 0) {
    overlays.drawSelected(scene, picture.selected);
  }
  const visible = visibleBodies(scene);
  const informed = drawBodies(scene, state, visible, layers.headings);
  if (picture.preferences) {
    overlays.drawVectors(scene, visible, picture.preferences);
  } else if (informed.length > 0) {
    overlays.drawVectors(scene, informed, directions(state));
  }
  if (layers.contacts) {
    overlays.drawContacts(scene, picture.pairs);
  }
  if (layers.clusters) {
    overlays.labelClusters(scene, picture.clusters);
  }
  overlays.drawScaleBar(scene);
  if (layers.headings) {
    overlays.drawHeadings(scene);
  }
  if (picture.lasso) {
    overlays.drawLasso(scene, picture.lasso);
  }
  if (picture.arrow) {
    overlays.drawArrow(scene, ...picture.arrow);
  }
}

/** The preferred direction of each, about as long as a body. */
function directions(state: Drawn): Float64Array {
  const found = new Float64Array(2 * state.id.length);
  state.direction.forEach((direction, i) => {
    found[2 * i] = 1.1 * Math.cos(direction);
    found[2 * i + 1] = 1.1 * Math.sin(direction);
  });
  return found;
}
