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
/** The side margin that keeps bodies clear of the buttons when every body is to be visible. */
const BUTTONS_PX = 52;

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
  /** Whether the scale fits every body, also one that has strayed far: from `follow` to a zoom or pan. */
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

  /** Zooms so that what is under (left, top) stays there; the centre stays while following. */
  zoomAt(left: number, top: number, factor: number): void {
    this.fitting = false;
    this.whole = false;
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
    this.whole = false;
    this.x -= right / this.scale;
    this.y += down / this.scale;
  }

  /** Follows again, with every body whole in the picture until the next zoom or pan. */
  follow(): void {
    this.following = true;
    this.fitting = true;
    this.whole = true;
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
    const side = this.whole ? BUTTONS_PX : MARGIN_PX;
    const fits = Math.min(
      inside(this.width, side) / extent.half_width,
      inside(this.height, MARGIN_PX) / extent.half_height,
    );
    if (!(LOOSE * fits <= this.fitted && this.fitted <= fits)) {
      const room = this.fitted === 0 ? 1 : 0.85;
      const least = this.whole ? Number.MIN_VALUE : LEAST_SCALE;
      this.fitted = Math.max(least, Math.min(fits * room, NEAREST_FIT));
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

  /** Stays where it is when positions are told relative to another origin. */
  rebase(dx: number, dy: number): void {
    this.x += dx;
    this.y += dy;
  }

  private fitted = 0;
}

/** Half of what is left of a length between two margins, which take half of it at most. */
function inside(length: number, margin: number): number {
  return Math.max(length / 2 - margin, length / 4);
}

/** Until `follow` is called the picture fits this share of a group: a few may have strayed far. */
const SHOWN_SHARE = 0.92;

/** How far the bodies reach from their centre of mass, all of them or all but a few. */
export function extentOf(x: Float64Array, y: Float64Array, whole: boolean): Extent {
  const share = whole ? 1 : SHOWN_SHARE;
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
