/**
 * Maps the plane to the screen. The y axis of the plane points up, that of the screen down;
 * positions are relative to the origin of the newest state.
 */

export interface Extent {
  x: number;
  y: number;
  /** The greatest distance from the centre of mass along each axis. */
  half_width: number;
  half_height: number;
}

export const MIN_SCALE = 0.05;
export const MAX_SCALE = 400;
/** The greatest scale that is chosen automatically: a small group does not fill the picture. */
const MAX_FIT_SCALE = 80;
/** The camera zooms in once the group is smaller than this share of the picture. */
const MIN_FILL = 0.55;
const MARGIN_PX = 26;

export class Camera {
  /** The point at the centre of the picture. */
  x = 0;
  y = 0;
  /** Pixels per body size. */
  scale = 24;
  width = 1;
  height = 1;
  /** The side margin that keeps bodies clear of the buttons when every body is to be visible. */
  buttons = MARGIN_PX;
  /** Whether the camera follows the centre of mass. */
  following = true;
  /** Whether the scale is chosen automatically: until the first zoom. */
  fitting = true;
  /** Whether the scale fits every body, however far out: from `follow` until a zoom or pan. */
  whole = false;

  toScreen(x: number, y: number): [number, number] {
    return [
      this.width / 2 + (x - this.x) * this.scale,
      this.height / 2 - (y - this.y) * this.scale,
    ];
  }

  toPlane(left: number, top: number): [number, number] {
    return [
      this.x + (left - this.width / 2) / this.scale,
      this.y - (top - this.height / 2) / this.scale,
    ];
  }

  /** Zooms about (left, top), or about the centre while following. */
  zoomAt(left: number, top: number, factor: number): void {
    this.fitting = false;
    this.whole = false;
    const [x, y] = this.toPlane(left, top);
    this.scale = Math.max(MIN_SCALE, Math.min(MAX_SCALE, this.scale * factor));
    if (!this.following) {
      const [x2, y2] = this.toPlane(left, top);
      this.x += x - x2;
      this.y += y - y2;
    }
  }

  /** Moves the plane by a distance in pixels, and stops following. */
  pan(right: number, down: number): void {
    this.following = false;
    this.whole = false;
    this.x -= right / this.scale;
    this.y += down / this.scale;
  }

  /** Follows the centre of mass and fits every body until the next zoom or pan. */
  follow(): void {
    this.following = true;
    this.fitting = true;
    this.whole = true;
    this.fitted = 0;
  }

  /** Follows the group; returns whether the scale is still changing. */
  track(extent: Extent, at_once: boolean): boolean {
    if (this.following) {
      this.x = extent.x;
      this.y = extent.y;
    }
    if (!this.following || !this.fitting) {
      return false;
    }
    const side = this.whole ? this.buttons : MARGIN_PX;
    const fits = Math.min(
      inside(this.width, side) / extent.half_width,
      inside(this.height, MARGIN_PX) / extent.half_height,
    );
    if (!(MIN_FILL * fits <= this.fitted && this.fitted <= fits)) {
      const margin = this.fitted === 0 ? 1 : 0.85;
      const least = this.whole ? Number.MIN_VALUE : MIN_SCALE;
      this.fitted = Math.max(least, Math.min(fits * margin, MAX_FIT_SCALE));
    }
    const rest = this.fitted / this.scale;
    const cuts =
      this.whole &&
      (this.scale * extent.half_width > this.width / 2 ||
        this.scale * extent.half_height > this.height / 2);
    if (at_once || cuts || Math.abs(Math.log(rest)) < 0.005) {
      this.scale = this.fitted;
      return false;
    }
    this.scale *= rest ** 0.12;
    return true;
  }

  /** Keeps its place in the plane when the origin of the positions changes. */
  rebase(dx: number, dy: number): void {
    this.x += dx;
    this.y += dy;
  }

  private fitted = 0;
}

/** Half of a length without two margins, which take at most half of it. */
function inside(length: number, margin: number): number {
  return Math.max(length / 2 - margin, length / 4);
}

/** Until `follow` is called the picture fits this share of a group: a few strays would shrink all others. */
const FITTED_SHARE = 0.92;

/** The extent of the bodies around their centre of mass, of all of them or of FITTED_SHARE. */
export function extentOf(x: Float64Array, y: Float64Array, whole: boolean): Extent {
  const share = whole ? 1 : FITTED_SHARE;
  const n = x.length;
  let sum_x = 0;
  let sum_y = 0;
  for (let i = 0; i < n; i += 1) {
    sum_x += x[i]!;
    sum_y += y[i]!;
  }
  const centre_x = n === 0 ? 0 : sum_x / n;
  const centre_y = n === 0 ? 0 : sum_y / n;
  // The longest body reaches one body size from its centre at most.
  const half_width = 1 + reach(x, centre_x, share);
  const half_height = 1 + reach(y, centre_y, share);
  return { x: centre_x, y: centre_y, half_width, half_height };
}

function reach(column: Float64Array, centre: number, share: number): number {
  const far = column.map((it) => Math.abs(it - centre)).sort();
  return far[Math.ceil(share * far.length) - 1] ?? 0;
}
