/** A small picture of a state, without layers and interpolation. */
import { bodyOf } from "../geometry/body.ts";
import { isDark } from "../ui/theme.ts";
import type { Drawn } from "../wire/state.ts";
import { clear, drawBodies } from "./bodies.ts";
import { Camera, extentOf } from "./camera.ts";
import { colours } from "./colours.ts";

const MARGIN_PX = 4;
/** Strays are left out if they would reduce the scale to less than this share. */
const MIN_WHOLE = 0.7;

export function drawThumbnail(canvas: HTMLCanvasElement, state: Drawn, pi1: number): void {
  const ratio = Math.min(2, devicePixelRatio);
  const camera = new Camera();
  camera.width = canvas.clientWidth;
  camera.height = canvas.clientHeight;
  const [width, height] = [Math.round(camera.width * ratio), Math.round(camera.height * ratio)];
  const g = canvas.getContext("2d");
  if (!g || width === 0 || height === 0) {
    return;
  }
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  const fit = (whole: boolean) => {
    const extent = extentOf(state.x, state.y, whole);
    const across = (camera.width / 2 - MARGIN_PX) / extent.half_width;
    const down = (camera.height / 2 - MARGIN_PX) / extent.half_height;
    return { extent, scale: Math.min(across, down) };
  };
  const [all, most] = [fit(true), fit(false)];
  const { extent, scale } = all.scale >= MIN_WHOLE * most.scale ? all : most;
  [camera.x, camera.y, camera.scale] = [extent.x, extent.y, scale];
  const scene = { g, camera, bodies: state, body: bodyOf(pi1), colours: colours(isDark()) };
  clear(scene);
  drawBodies(scene, state, Uint32Array.from(state.id.keys()));
}
