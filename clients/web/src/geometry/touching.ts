/** Pairs of touching bodies, and the clusters they form. */
import { type Body, gap } from "./body.ts";

/** Bodies with gaps of at most this, in body sizes, count as touching: contacts leave overlaps and
 * gaps of the order of dt². */
export const TOUCHING = 1e-3;

export interface Bodies {
  x: Float64Array;
  y: Float64Array;
  alpha: Float64Array;
}

/** A distinct number for each cell of the plane around the origin. */
function cellKey(column: number, row: number): number {
  return (column + 2 ** 20) * 2 ** 21 + row + 2 ** 20;
}

/**
 * The pairs i < j of bodies that touch, as i, j, i, j, …, found with a grid of cells as wide as a
 * body is long: touching bodies are in the same or in adjacent cells.
 */
export function findTouching(bodies: Bodies, body: Body): Uint32Array {
  const { x, y, alpha } = bodies;
  const width = 2 * (body.half_length + body.radius) + TOUCHING;
  const cells = new Map<number, number[]>();
  const pairs: number[] = [];
  for (let j = 0; j < x.length; j += 1) {
    const column = Math.floor(x[j]! / width);
    const row = Math.floor(y[j]! / width);
    for (let u = column - 1; u <= column + 1; u += 1) {
      for (let v = row - 1; v <= row + 1; v += 1) {
        for (const i of cells.get(cellKey(u, v)) ?? []) {
          const dx = x[j]! - x[i]!;
          const dy = y[j]! - y[i]!;
          if (
            dx * dx + dy * dy < width * width &&
            gap(dx, dy, alpha[i]!, alpha[j]!, body) <= TOUCHING
          ) {
            pairs.push(i, j);
          }
        }
      }
    }
    const key = cellKey(column, row);
    const cell = cells.get(key);
    if (cell) {
      cell.push(j);
    } else {
      cells.set(key, [j]);
    }
  }
  return Uint32Array.from(pairs);
}

/** The clusters of more than one member, each in ascending order, the largest first. */
export function findClusters(n: number, pairs: Uint32Array): number[][] {
  const parent = Uint32Array.from({ length: n }, (_, i) => i);
  const root = (i: number): number => {
    let at = i;
    while (parent[at] !== at) {
      parent[at] = parent[parent[at]!]!;
      at = parent[at]!;
    }
    return at;
  };
  for (let k = 0; k < pairs.length; k += 2) {
    const a = root(pairs[k]!);
    const b = root(pairs[k + 1]!);
    parent[Math.max(a, b)] = Math.min(a, b);
  }
  const members = new Map<number, number[]>();
  for (let i = 0; i < n; i += 1) {
    const at = root(i);
    const cluster = members.get(at);
    if (cluster) {
      cluster.push(i);
    } else {
      members.set(at, [i]);
    }
  }
  const clusters = [...members.values()].filter((cluster) => cluster.length > 1);
  return clusters.sort((a, b) => b.length - a.length || a[0]! - b[0]!);
}

/** The measures `clusters.*` of n individuals; a single individual is a cluster, too. */
export interface ClusterNumbers {
  count: number;
  largest: number;
  /** The mean size of the cluster of an individual. */
  n_eff: number;
}

/** The measures of clusters as `findClusters` returns them; null for an empty group. */
export function clusterNumbers(n: number, clusters: readonly number[][]): ClusterNumbers | null {
  if (n === 0) {
    return null;
  }
  const members = clusters.reduce((sum, it) => sum + it.length, 0);
  const squares = clusters.reduce((sum, it) => sum + it.length ** 2, 0);
  const single = n - members;
  return {
    count: clusters.length + single,
    largest: clusters[0]?.length ?? 1,
    n_eff: (squares + single) / n,
  };
}

/** The share of the individuals that touch another. */
export function touchingShare(n: number, pairs: Uint32Array): number {
  return n === 0 ? 0 : new Set(pairs).size / n;
}
