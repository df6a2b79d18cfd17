/** Axes with ticks along the edges of the surface's box that face the eye, where nothing can hide them. */

import { label, type Ink, type Pen2D } from "./annotate";
import { worldAt } from "./grid";
import { decimalsOf, fixed, ticks, tickStep, unitSign } from "./numbers";
import type { Project } from "./overlay3d";
import type { Surface } from "./types";

type Screen = [number, number];

export function drawAxes(
  pen: Pen2D, ink: Ink, surface: Surface, [low, high]: [number, number], project: Project, azimuthDeg: number, width: number,
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
      if (!place) continue;
      stroke(place, [place[0] + 5 * out[0], place[1] + 5 * out[1]]);
      pen.fillStyle = ink.quiet;
      pen.fillText(fixed(mark, decimals), place[0] + 9 * out[0], place[1] + 9 * out[1]);
    }
    const title = `${name} (${sign})`;
    if (name === "z") {
      // Above its axis: beside it there is little room.
      pen.textAlign = "center";
      pen.textBaseline = "bottom";
      label(pen, ink, title, Math.max(28, to[0]), to[1] - 10);
      return;
    }
    const letters = pen.measureText(title).width;
    // Never beyond the view's edge, where it would be cut.
    const before = { left: 0, center: 0.5, right: 1 }[pen.textAlign as "left" | "center" | "right"] * letters;
    const x = Math.min(width - 6 - letters + before, Math.max(6 + before, half[0] + 38 * out[0]));
    label(pen, ink, title, x, half[1] + 30 * out[1]);
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
