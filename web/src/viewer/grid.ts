/** What the views and tools need of a grid of heights: ranges, slopes, where it is cut, values between its points. */

import type { Surface } from "./types";

/** A grid of heights, of the surface or a coarser one of it. */
export type Heights = Pick<Surface, "rows" | "cols" | "pixelSize" | "height">;

/** Steeper than this is a jump in depth and no surface; the same as of the run's mesh (83 deg). */
const STEEPEST_SLOPE = 8;

/** Return the given shares (0 to 1) of the known values' distribution, from at most about 200,000 of them. */
export function percentiles(values: Float32Array, shares: number[]): number[] {
  const step = Math.max(1, Math.floor(values.length / 200_000));
  const some = new Float32Array(Math.ceil(values.length / step));
  let count = 0;
  for (let i = 0; i < values.length; i += step) if (Number.isFinite(values[i])) some[count++] = values[i];
  if (!count) return shares.map(() => NaN);
  const sorted = some.subarray(0, count).sort();
  return shares.map((share) => {
    const place = share * (sorted.length - 1);
    const first = Math.floor(place);
    const next = Math.min(first + 1, sorted.length - 1);
    return sorted[first] + (place - first) * (sorted[next] - sorted[first]);
  });
}

/** Return lowest and highest known height, NaN where there is none. */
export function heightRange(height: Float32Array): [number, number] {
  let low = Infinity;
  let high = -Infinity;
  for (let i = 0; i < height.length; i++) {
    const value = height[i];
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return low <= high ? [low, high] : [NaN, NaN];
}

/**
 * Return for each cell between four heights which of its triangles are surface: 1 for the upper left one, 2 for the
 * lower right one. A triangle with an unknown corner, or that is too steep, is none.
 */
export function triangleMask(surface: Heights): Uint8Array {
  const { rows, cols, height } = surface;
  const limit = STEEPEST_SLOPE * surface.pixelSize;
  const mask = new Uint8Array(Math.max(0, (rows - 1) * (cols - 1)));
  for (let row = 0, k = 0; row < rows - 1; row++) {
    for (let col = 0, i = row * cols; col < cols - 1; col++, i++, k++) {
      const a = height[i];
      const b = height[i + 1];
      const c = height[i + cols];
      const d = height[i + cols + 1];
      // A comparison with NaN is false, so that an unknown corner cuts.
      const across = Math.max(b, c) - Math.min(b, c);
      if (across <= limit) {
        if (Math.max(a, b, c) - Math.min(a, b, c) <= limit) mask[k] = 1;
        if (Math.max(b, c, d) - Math.min(b, c, d) <= limit) mask[k] |= 2;
      }
    }
  }
  return mask;
}

/** Return heights without gaps, for vertices that are never seen: an unknown one takes over its neighbour's. */
export function withoutGaps(surface: Heights): Float32Array {
  const { rows, cols } = surface;
  const filled = surface.height.slice();
  let lastKnownRow = -1;
  for (let row = 0; row < rows; row++) {
    const start = row * cols;
    let last = NaN;
    let first = -1;
    for (let i = start; i < start + cols; i++) {
      if (Number.isNaN(filled[i])) filled[i] = last;
      else {
        last = filled[i];
        if (first < 0) first = i;
      }
    }
    if (first >= 0) {
      filled.fill(filled[first], start, first);
      if (lastKnownRow < 0) for (let r = 0; r < row; r++) filled.copyWithin(r * cols, start, start + cols);
      lastKnownRow = row;
    } else if (lastKnownRow >= 0) filled.copyWithin(start, lastKnownRow * cols, (lastKnownRow + 1) * cols);
  }
  if (lastKnownRow < 0) filled.fill(0);
  return filled;
}

/** Write the slopes dz/dx and dz/dy (y up) at a point; one-sided beside a gap, 0 where nothing is known. */
export function slopeAt(surface: Heights, row: number, col: number, out: Float32Array | number[]): void {
  const { rows, cols, height, pixelSize } = surface;
  const i = row * cols + col;
  const here = height[i];
  out[0] = slope(col > 0 ? height[i - 1] : NaN, here, col < cols - 1 ? height[i + 1] : NaN) / pixelSize;
  out[1] = -slope(row > 0 ? height[i - cols] : NaN, here, row < rows - 1 ? height[i + cols] : NaN) / pixelSize;
}

function slope(before: number, here: number, after: number): number {
  const forward = after - here;
  const backward = here - before;
  if (forward === forward) return backward === backward ? 0.5 * (forward + backward) : forward;
  return backward === backward ? backward : 0;
}

/** Return the height between four grid points, bilinear; NaN outside, and where one that is needed is unknown. */
export function heightAt(surface: Heights, x: number, y: number): number {
  const { rows, cols, height } = surface;
  if (!(x >= 0 && y >= 0 && x <= cols - 1 && y <= rows - 1)) return NaN;
  const col = Math.floor(x);
  const row = Math.floor(y);
  const fx = x - col;
  const fy = y - row;
  const i = row * cols + col;
  // A weight of zero asks nothing of its height: a grid point beside a gap is known.
  let value = (1 - fx) * (1 - fy) * height[i];
  if (fx) value += fx * (1 - fy) * height[i + 1];
  if (fy) value += (1 - fx) * fy * height[i + cols];
  if (fx && fy) value += fx * fy * height[i + cols + 1];
  return value;
}

/** Return world x, y of a place in the grid, whose height is z. */
export function worldAt(surface: Surface, x: number, y: number, z: number): [number, number, number] {
  const m = surface.worldFromGrid;
  const row = (r: number): number => m[4 * r] * x + m[4 * r + 1] * y + m[4 * r + 2] * z + m[4 * r + 3];
  return [row(0), row(1), row(2)];
}

/** Return the place in the grid, and the height there, of a point of the world. */
export function gridFromWorld(surface: Surface, point: ArrayLike<number>): [number, number, number] {
  const m = surface.worldFromGrid;
  // The map is seen along z: x depends on the column alone, and y on the row.
  return [(point[0] - m[3]) / m[0], (point[1] - m[7]) / m[5], (point[2] - m[11]) / m[10]];
}
