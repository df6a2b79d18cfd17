/** Parts of the grid: a rectangle by two opposite corners, a polygon by three and more. Edges belong to their part. */

import type { Place } from "./types";

/** Corners of a part. */
export type Ring = Place[];

export interface Part {
  row0: number;
  row1: number;
  col0: number;
  col1: number;
  /** Whether the centre of a height lies in the part. */
  has(row: number, col: number): boolean;
}

/** Return the heights whose centres lie in a ring; all of them without one. */
export function partOf({ rows, cols }: { rows: number; cols: number }, ring?: Ring): Part {
  const xs = ring?.map((place) => place.x) ?? [0, cols - 1];
  const ys = ring?.map((place) => place.y) ?? [0, rows - 1];
  const row0 = Math.max(0, Math.ceil(Math.min(...ys)));
  const row1 = Math.min(rows - 1, Math.floor(Math.max(...ys)));
  const col0 = Math.max(0, Math.ceil(Math.min(...xs)));
  const col1 = Math.min(cols - 1, Math.floor(Math.max(...xs)));
  const within = (row: number, col: number): boolean => row >= row0 && row <= row1 && col >= col0 && col <= col1;
  if (!ring || ring.length < 3) return { row0, row1, col0, col1, has: within };
  const width = col1 - col0 + 1;
  const inside = new Uint8Array(Math.max(0, width) * Math.max(0, row1 - row0 + 1));
  for (let row = row0; row <= row1; row++) {
    for (const [from, to] of spans(ring, row)) {
      const first = Math.max(col0, Math.ceil(from));
      const last = Math.min(col1, Math.floor(to));
      if (first <= last) inside.fill(1, (row - row0) * width + first - col0, (row - row0) * width + last - col0 + 1);
    }
  }
  return { row0, row1, col0, col1, has: (row, col) => within(row, col) && inside[(row - row0) * width + col - col0] === 1 };
}

/** Return where a row runs inside a polygon (even-odd), the polygon's own edges and corners too. */
function spans(ring: Ring, row: number): [number, number][] {
  const crossings: number[] = [];
  const found: [number, number][] = [];
  ring.forEach((a, i) => {
    const b = ring[(i + 1) % ring.length];
    if (a.y > row !== b.y > row) crossings.push(a.x + ((row - a.y) * (b.x - a.x)) / (b.y - a.y));
    // An edge along the row, and a corner that only touches it.
    if (a.y === row) found.push(b.y === row ? [Math.min(a.x, b.x), Math.max(a.x, b.x)] : [a.x, a.x]);
  });
  crossings.sort((one, other) => one - other);
  for (let k = 0; k + 1 < crossings.length; k += 2) found.push([crossings[k], crossings[k + 1]]);
  return found;
}

/** Whether a height of a part has a neighbour that is not of it. */
export function isOnRim(part: Part, row: number, col: number): boolean {
  return !(part.has(row - 1, col) && part.has(row + 1, col) && part.has(row, col - 1) && part.has(row, col + 1));
}

/** Return the corners of a ring in turn: four of a rectangle. */
export function outline(ring: Ring): Place[] {
  if (ring.length !== 2) return ring;
  const [a, b] = ring;
  return [a, { x: b.x, y: a.y }, b, { x: a.x, y: b.y }];
}
