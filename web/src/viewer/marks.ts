/** The places that are marked for a tool: points, or the corners of regions. Values only; every change is a new one. */

import type { Ring } from "./region";
import type { Tool } from "./tools";
import type { Place } from "./types";

export type Shape = "rectangle" | "polygon";

export interface Marks {
  places: Place[];
  /** Of each region that is closed, the number of places up to its end. */
  ends: number[];
}

export const NO_MARKS: Marks = { places: [], ends: [] };

/** Return the corners of the regions that are closed: two of a rectangle, more of a polygon. */
export function closedRings({ places, ends }: Marks): Ring[] {
  return ends.map((end, i) => places.slice(i ? ends[i - 1] : 0, end));
}

/** Return the places after the last closed region. */
export function openPlaces({ places, ends }: Marks): Place[] {
  return places.slice(ends.at(-1) ?? 0);
}

/** Whether a tool has all that it asks for. */
export function isComplete(tool: Tool, marks: Marks): boolean {
  return tool.regions ? marks.ends.length === tool.regions : marks.places.length === tool.points;
}

/** Whether a tool takes a polygon now that has corners enough to be closed. */
export function canClose(tool: Tool, shape: Shape, marks: Marks): boolean {
  return tool.regions > marks.ends.length && shape === "polygon" && openPlaces(marks).length >= 3;
}

/**
 * Return the marks with one place more; where the tool has all of them, with the first of a new measurement. A polygon
 * is closed by a place that is its first or its last corner.
 */
export function withPlace(tool: Tool, shape: Shape, marks: Marks, place: Place): Marks {
  if (!tool.points && !tool.regions) return marks;
  if (isComplete(tool, marks)) return { places: [place], ends: [] };
  const open = openPlaces(marks);
  if (tool.regions && shape === "polygon") {
    const isThere = [open[0], open.at(-1)].some((corner) => corner?.x === place.x && corner.y === place.y);
    if (isThere) return canClose(tool, shape, marks) ? closed(marks) : marks;
  }
  const added = { places: [...marks.places, place], ends: marks.ends };
  return tool.regions && shape === "rectangle" && open.length === 1 ? closed(added) : added;
}

/** Return the marks with their open region closed. */
export function closed({ places, ends }: Marks): Marks {
  return { places, ends: [...ends, places.length] };
}

/** Return the marks with one place elsewhere. */
export function withMoved({ places, ends }: Marks, index: number, place: Place): Marks {
  return { places: places.map((old, i) => (i === index ? place : old)), ends };
}

/** Return the marks without what was done last: a place, or the closing of a polygon. */
export function takenBack(marks: Marks): Marks {
  const last = closedRings(marks).at(-1);
  if (!openPlaces(marks).length && last && last.length > 2) return { places: marks.places, ends: marks.ends.slice(0, -1) };
  const places = marks.places.slice(0, -1);
  return { places, ends: marks.ends.filter((end) => end <= places.length) };
}

/** Return the marks without the region that is being drawn; none where no region is, or a measurement is complete. */
export function cancelled(marks: Marks): Marks {
  const open = openPlaces(marks).length;
  return open && marks.ends.length ? { places: marks.places.slice(0, -open), ends: marks.ends } : NO_MARKS;
}

/** Return marks of an earlier time, where they fit a tool and a grid. */
export function restoredMarks(kept: unknown, tool: Tool, { rows, cols }: { rows: number; cols: number }): Marks {
  const { places, ends } = (kept ?? {}) as Partial<Marks>;
  if (!Array.isArray(places) || !Array.isArray(ends)) return NO_MARKS;
  const inside = places.every((place) => place?.x >= 0 && place.y >= 0 && place.x < cols && place.y < rows);
  const inOrder = ends.every((end, i) => Number.isInteger(end) && end >= (i ? ends[i - 1] : 0) + 2 && end <= places.length);
  return inside && inOrder && ends.length <= tool.regions ? { places, ends } : NO_MARKS;
}
