/** Where a ray meets the heights: a march along the grid, exact between its points. */

import type { Vector3 } from "three";
import { heightAt } from "./grid";
import type { Surface } from "./types";

/**
 * Return x, y in the grid and the height where a ray from `start` to `end`, both in the grid (x, y in px, z a height),
 * first comes from above to below the known surface (or the other way, for a view from below); null where it misses.
 */
export function pickHeight(
  surface: Surface, [low, high]: [number, number], start: Vector3, end: Vector3,
): [number, number, number] | null {
  const along = end.clone().sub(start);
  // Only where the ray is inside the box of the heights.
  let first = 0;
  let last = 1;
  const bounds: [number, number, number, number][] = [
    [start.x, along.x, 0, surface.cols - 1],
    [start.y, along.y, 0, surface.rows - 1],
    [start.z, along.z, low - 1e-6 * (high - low), high + 1e-6 * (high - low)],
  ];
  for (const [from, by, least, most] of bounds) {
    if (Math.abs(by) < 1e-12) {
      if (from < least || from > most) return null;
      continue;
    }
    const ends = [(least - from) / by, (most - from) / by].sort((a, b) => a - b);
    first = Math.max(first, ends[0]);
    last = Math.min(last, ends[1]);
  }
  if (!(first <= last)) return null;
  const over = (t: number): number =>
    start.z + t * along.z - heightAt(surface, start.x + t * along.x, start.y + t * along.y);
  const steps = Math.max(1, Math.ceil((2 * (last - first)) * Math.hypot(along.x, along.y)));
  let before = NaN;
  for (let i = 0; i <= steps; i++) {
    const t = first + (i / steps) * (last - first);
    const here = over(t);
    if (here === 0 || here * before < 0) {
      let near = first + ((i - 1) / steps) * (last - first);
      let far = t;
      for (let round = 0; round < 30 && here !== 0; round++) {
        const middle = 0.5 * (near + far);
        if (over(middle) * before > 0) near = middle;
        else far = middle;
      }
      const [x, y] = [start.x + far * along.x, start.y + far * along.y];
      return [x, y, heightAt(surface, x, y)];
    }
    if (!Number.isNaN(here)) before = here;
    else before = NaN;
  }
  return null;
}
