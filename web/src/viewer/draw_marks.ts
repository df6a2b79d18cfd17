/** What the tools draw over both views: points, lines, regions, and the linked cursor. */

import { drawDot, drawPath, type Ink, type Pen2D } from "./annotate";
import { closedRings, isComplete, openPlaces, type Marks, type Shape } from "./marks";
import { outline } from "./region";
import type { Tool } from "./tools";
import type { Place } from "./types";

/** Tells where a place of the grid is in a view; null where it is not seen. */
export type Find = (x: number, y: number) => [number, number] | null;

const MOST_STEPS = 400;

/** Draw a tool's marks, and what the next place would make of them; `dense` follows the surface between places. */
export function drawMarks(
  pen: Pen2D, ink: Ink, tool: Tool, shape: Shape, marks: Marks, cursor: Place | null, find: Find, dense: boolean,
): void {
  const line = (places: Place[], colour: string): void => {
    const path = places.slice(1).flatMap((to, i) => between(places[i], to, find, dense));
    if (path.length) drawPath(pen, ink, path, colour);
  };
  const colourOf = (region: number): string => (region ? ink.second : ink.accent);
  closedRings(marks).forEach((ring, i) => {
    const corners = outline(ring);
    line([...corners, corners[0]], colourOf(i));
  });
  const open = openPlaces(marks);
  const waiting = cursor && open.length && !isComplete(tool, marks) ? [...open, cursor] : open;
  const isRectangle = tool.regions && shape === "rectangle" && waiting.length === 2;
  const corners = isRectangle ? outline(waiting) : waiting;
  line(isRectangle ? [...corners, corners[0]] : corners, colourOf(marks.ends.length));
  let region = 0;
  marks.places.forEach((place, i) => {
    while (i >= (marks.ends[region] ?? Infinity)) region++;
    const isFirst = i === (region ? marks.ends[region - 1] : 0);
    const name = !tool.regions ? "ABC"[i] : tool.regions > 1 && isFirst ? String(region + 1) : "";
    const at = find(place.x, place.y);
    if (at) drawDot(pen, ink, at, colourOf(region), name);
  });
}

function between(from: Place, to: Place, find: Find, dense: boolean): ([number, number] | null)[] {
  const steps = dense ? Math.min(MOST_STEPS, Math.max(1, Math.ceil(Math.hypot(to.x - from.x, to.y - from.y)))) : 1;
  return Array.from({ length: steps + 1 }, (_, i) =>
    find(from.x + (i / steps) * (to.x - from.x), from.y + (i / steps) * (to.y - from.y)),
  );
}

/** Draw the linked cursor. */
export function drawCursor(pen: Pen2D, ink: Ink, [x, y]: [number, number]): void {
  for (const [colour, width] of [[ink.halo, 3.5], [ink.text, 1.5]] as const) {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      pen.moveTo(x + 4 * dx, y + 4 * dy);
      pen.lineTo(x + 12 * dx, y + 12 * dy);
    }
    pen.stroke();
  }
}
