/**
 * Which part of the plane is seen. The plane has y upwards, the screen downwards; positions are
 * relative to the origin of the newest state.
 */

export interface Extent {
  x: number;
  y: number;
  /** How far the group reaches from its centre of mass, each way. */
  half_width: number;
  half_height: number;
}

export const LEAST_SCALE = 0.05;
export const MOST_SCALE = 400;
/** Nobody is so near that three bodies fill the picture. */
const NEAREST_FIT = 80;
/** A group that has become this much smaller than the picture is shown larger again. */
const LOOSE = 0.55;
const MARGIN_PX = 26;

export class Camera {
  /** The point in the middle. */
  x = 0;
  y = 0;
  /** Pixels to a body size. */
  scale = 24;
  width = 1;
  height = 1;
  /** Whether the centre of mass stays in the middle. */
  following = true;
  /** Whether the scale is the page's to choose: until somebody zooms. */
  fitting = true;

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

  /** Zooms so that what is under (left, top) stays there; the centre stays while following. */
  zoomAt(left: number, top: number, factor: number): void {
    this.fitting = false;
    const [x, y] = this.toPlane(left, top);
    this.scale = Math.max(LEAST_SCALE, Math.min(MOST_SCALE, this.scale * factor));
    if (!this.following) {
      const [x2, y2] = this.toPlane(left, top);
      this.x += x - x2;
      this.y += y - y2;
    }
  }

  /** Drags the plane by so many pixels, and no longer follows. */
  pan(right: number, down: number): void {
    this.following = false;
    this.x -= right / this.scale;
    this.y += down / this.scale;
  }

  /** Follows again, with everybody in the picture. */
  follow(): void {
    this.following = true;
    this.fitting = true;
    this.fitted = 0;
  }

  /** Moves with the group; returns whether the scale is still on its way. */
  track(extent: Extent, at_once: boolean): boolean {
    if (this.following) {
      this.x = extent.x;
      this.y = extent.y;
    }
    if (!this.following || !this.fitting) {
      return false;
    }
    const fits = Math.min(
      (this.width / 2 - MARGIN_PX) / extent.half_width,
      (this.height / 2 - MARGIN_PX) / extent.half_height,
    );
    if (!(LOOSE * fits <= this.fitted && this.fitted <= fits)) {
      const room = this.fitted === 0 ? 1 : 0.85;
      this.fitted = Math.max(LEAST_SCALE, Math.min(fits * room, NEAREST_FIT));
    }
    const rest = this.fitted / this.scale;
    if (at_once || Math.abs(Math.log(rest)) < 0.005) {
      this.scale = this.fitted;
      return false;
    }
    this.scale *= rest ** 0.12;
    return true;
  }

  /** Stays where it is when positions are told relative to another origin. */
  rebase(dx: number, dy: number): void {
    this.x += dx;
    this.y += dy;
  }

  private fitted = 0;
}

/** Of a group this share is in the picture for certain: a few may have strayed far. */
const SHOWN_SHARE = 0.92;

/** How far the bodies reach from their centre of mass, but for a few. */
export function extentOf(x: Float64Array, y: Float64Array): Extent {
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
  const half_width = 1 + reach(x, centre_x);
  const half_height = 1 + reach(y, centre_y);
  return { x: centre_x, y: centre_y, half_width, half_height };
}

function reach(column: Float64Array, centre: number): number {
  const far = column.map((it) => Math.abs(it - centre)).sort();
  return far[Math.ceil(SHOWN_SHARE * far.length) - 1] ?? 0;
}
