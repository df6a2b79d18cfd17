/** Axes with ticks along the edges of the surface's box that face the eye, where nothing can hide them. */

import { label, type Ink, type Pen2D } from "./annotate";
import { worldAt } from "./grid";
import { decimalsOf, fixed, ticks, tickStep, unitSign } from "./numbers";
import type { Project } from "./overlay3d";
import type { Surface } from "./types";

type Screen = [number, number];

/** What z is stretched by stands above. */
const TITLE_BELOW_PX = 50;
const EDGE_PX = 6;

/** Return a place for letters, moved to where the view does not cut them. */
function inside(pen: Pen2D, text: string, x: number, y: number, width: number, height: number): Screen {
  const letters = pen.measureText(text).width;
  const before = { left: 0, center: 0.5, right: 1 }[pen.textAlign as "left" | "center" | "right"] * letters;
  const size = 12;
  const above = { top: 0, middle: 0.5, bottom: 1 }[pen.textBaseline as "top" | "middle" | "bottom"] * size;
  return [
    Math.min(width - EDGE_PX - letters + before, Math.max(EDGE_PX + before, x)),
    Math.min(height - EDGE_PX - size + above, Math.max(EDGE_PX + above, y)),
  ];
}

export function drawAxes(
  pen: Pen2D, ink: Ink, surface: Surface, [low, high]: [number, number], project: Project, azimuthDeg: number,
  [width, height]: [number, number],
): void {
  const { rows, cols } = surface;
  const azimuth = (azimuthDeg * Math.PI) / 180;
  // The eye stands on the side of these edges; rows count downwards, so towards smaller y.
  const nearX = Math.cos(azimuth) > 0 ? cols - 1 : 0;
  const nearY = Math.sin(azimuth) > 0 ? 0 : rows - 1;
  const farX = cols - 1 - nearX;
  const farY = rows - 1 - nearY;
  const sign = unitSign(surface.unit);
  const corners: [number, number][] = [[0, 0], [cols - 1, 0], [cols - 1, rows - 1], [0, rows - 1]];
  const base = corners.map(([x, y]) => project(x, y, low));
  const middle = project((cols - 1) / 2, (rows - 1) / 2, low);
  if (!middle || base.some((place) => !place)) return;
  const stroke = (from: Screen, to: Screen): void => {
    pen.lineWidth = 1;
    pen.strokeStyle = ink.quiet;
    pen.beginPath();
    pen.moveTo(...from);
    pen.lineTo(...to);
    pen.stroke();
  };
  const axis = (name: string, least: number, most: number, at: (value: number) => Screen | null, length: number): void => {
    const [from, to] = [at(least), at(most)];
    if (!from || !to) return;
    stroke(from, to);
    const size = Math.hypot(to[0] - from[0], to[1] - from[1]);
    if (size < 24) return;
    let out: Screen = [to[1] - from[1], from[0] - to[0]];
    const half: Screen = [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2];
    if (out[0] * (half[0] - middle[0]) + out[1] * (half[1] - middle[1]) < 0) out = [-out[0], -out[1]];
    out = [out[0] / size, out[1] / size];
    const wanted = Math.max(1, Math.min(length, size / (name === "z" ? 24 : 55)));
    const marks = ticks(least, most, wanted);
    const decimals = decimalsOf(tickStep(least, most, wanted));
    pen.textAlign = out[0] > 0.35 ? "left" : out[0] < -0.35 ? "right" : "center";
    pen.textBaseline = out[1] > 0.35 ? "top" : out[1] < -0.35 ? "bottom" : "middle";
    for (const mark of marks) {
      const place = at(mark);
      if (!place || place[0] < 0 || place[1] < 0 || place[0] > width || place[1] > height) continue;
      stroke(place, [place[0] + 5 * out[0], place[1] + 5 * out[1]]);
      const text = fixed(mark, decimals);
      pen.fillStyle = ink.quiet;
      pen.fillText(text, ...inside(pen, text, place[0] + 9 * out[0], place[1] + 9 * out[1], width, height));
    }
    const title = `${name} (${sign})`;
    if (name === "z") {
      // Above its axis: beside it there is little room. Where the axis leaves the view, at its edge.
      const top = Math.max(to[1] - 10, TITLE_BELOW_PX);
      const along = Math.min(1, Math.max(0, (from[1] - top) / Math.max(1, from[1] - to[1])));
      const isCut = to[1] - 10 < top;
      pen.textAlign = isCut ? "left" : "center";
      pen.textBaseline = "bottom";
      const x = isCut ? from[0] + along * (to[0] - from[0]) + 9 : to[0];
      label(pen, ink, title, ...inside(pen, title, x, top, width, height));
      return;
    }
    label(pen, ink, title, ...inside(pen, title, half[0] + 38 * out[0], half[1] + 30 * out[1], width, height));
  };
  const m = surface.worldFromGrid;
  const worldX = (x: number): number => worldAt(surface, x, 0, 0)[0];
  const worldY = (y: number): number => worldAt(surface, 0, y, 0)[1];
  axis("x", worldX(0), worldX(cols - 1), (value) => project((value - m[3]) / m[0], nearY, low), 6);
  axis("y", worldY(rows - 1), worldY(0), (value) => project(nearX, (value - m[7]) / m[5], low), 6);
  // The upright edge at the outline of the box, to the left.
  const left = project(nearX, farY, low)![0] < project(farX, nearY, low)![0] ? [nearX, farY] : [farX, nearY];
  axis("z", low, high, (value) => project(left[0], left[1], value), 4);
}
