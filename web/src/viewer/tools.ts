/** The measuring tools: what each asks for, what it draws, and what it finds. */

import { drawDot, drawPath, label, type Ink, type Pen2D } from "./annotate";
import { heightAt } from "./grid";
import {
  angleAt,
  distanceBetween,
  extractProfile,
  profileFigures,
  stepBetween,
  type Place,
  type Profile,
  type Rectangle,
} from "./measure";
import { areaAndVolume, arealFigures, type VolumeReference } from "./measure_area";
import { number, roundLength, unitSign } from "./numbers";
import type { Surface } from "./types";

export type ToolName = "inspect" | "profile" | "distance" | "angle" | "step" | "region" | "texture";

export interface Tool {
  name: ToolName;
  title: string;
  /** Places it asks for. */
  asks: number;
  /** Places are corners of rectangles, by twos. */
  rectangles: boolean;
  /** What to do next, for each number of places that are set. */
  hints: string[];
  icon: string;
}

const CORNERS = ["Mark a corner of the region", "Mark the opposite corner", "Drag a corner to change the region"];

export const TOOLS: Tool[] = [
  { name: "inspect", title: "Inspect", asks: 0, rectangles: false, icon: "M12 3v5m0 8v5M3 12h5m8 0h5", hints: ["Point at a place to read its height; drag to turn or move the view"] },
  { name: "profile", title: "Profile", asks: 2, rectangles: false, icon: "M3 16l4-6 4 4 4-8 3 6 3-2", hints: ["Mark the start of the line", "Mark its end", "Drag an end to change the line"] },
  { name: "distance", title: "Distance", asks: 2, rectangles: false, icon: "M5 19L19 5M4 14l6 6M14 4l6 6", hints: ["Mark the first point", "Mark the second point", "Drag a point to change it"] },
  { name: "angle", title: "Angle", asks: 3, rectangles: false, icon: "M4 19h17M4 19L17 5M12 19a9 9 0 0 0-2.5-6", hints: ["Mark a point on the first leg", "Mark the corner", "Mark a point on the second leg", "Drag a point to change it"] },
  { name: "step", title: "Step", asks: 4, rectangles: true, icon: "M3 18h8V7h10", hints: ["First region: mark a corner", "First region: mark the opposite corner", "Second region: mark a corner", "Second region: mark the opposite corner", "Drag a corner to change a region"] },
  { name: "region", title: "Area and volume", asks: 2, rectangles: true, icon: "M4 8l8-4 8 4v8l-8 4-8-4zM4 8l8 4 8-4M12 12v8", hints: CORNERS },
  { name: "texture", title: "ISO 25178", asks: 2, rectangles: true, icon: "M3 8q3-5 6 0t6 0 6 0M3 16q3-5 6 0t6 0 6 0", hints: ["The whole surface; mark a corner to take a region", "Mark the opposite corner", "Drag a corner to change the region"] },
];

export function toolOf(name: string): Tool {
  return TOOLS.find((tool) => tool.name === name) ?? TOOLS[0];
}

/** A row of a table of figures. */
export interface Row {
  name: string;
  value: number;
  unit: string;
  /** In the unit. */
  sigma?: number;
  note?: string;
}

export interface Finding {
  rows: Row[];
  /** Why there is no figure. */
  trouble?: string;
  profile?: Profile;
}

export interface Choices {
  /** Lambda c of the profile in the surface's unit; 0 takes a fifth of the length. */
  nestingIndex: number;
  reference: VolumeReference;
}

/** Return what a tool finds at its places; null as long as it waits for more. */
export function finding(tool: Tool, surface: Surface, places: Place[], choices: Choices): Finding | null {
  const sign = unitSign(surface.unit);
  const scale = surface.heightScaleRelativeSigma ?? NaN;
  if (tool.name === "texture") {
    if (places.length === 1) return null;
    const found = arealFigures(surface, places.length === 2 ? rectangle(places, 0) : undefined);
    if (!found) return none("fewer than three heights are known there");
    return {
      rows: [
        { name: "Sa", value: found.Sa, unit: sign, sigma: found.Sa * scale, note: "mean height" },
        { name: "Sq", value: found.Sq, unit: sign, sigma: found.Sq * scale, note: "root mean square" },
        { name: "Ssk", value: found.Ssk, unit: "", note: "skewness" },
        { name: "Sku", value: found.Sku, unit: "", note: "kurtosis" },
        { name: "Sp", value: found.Sp, unit: sign, sigma: found.Sp * scale, note: "highest peak" },
        { name: "Sv", value: found.Sv, unit: sign, sigma: found.Sv * scale, note: "deepest pit" },
        { name: "Sz", value: found.Sz, unit: sign, sigma: found.Sz * scale, note: "highest to deepest" },
        { name: "Sdq", value: found.Sdq, unit: "", note: "root mean square slope, neighbours" },
        { name: "Sdr", value: found.Sdr, unit: "%", note: "developed area beyond the projected" },
      ],
    };
  }
  if (places.length < tool.asks || !tool.asks) return null;
  switch (tool.name) {
    case "profile": {
      const profile = extractProfile(surface, places[0], places[1]);
      const length = profile.distance[profile.distance.length - 1];
      const found = profileFigures(profile, nestingIndexOf(choices, length));
      if (!found) return none("fewer than eight heights along the line are known; draw it over the known part");
      return {
        profile,
        rows: [
          { name: "Length", value: length, unit: sign },
          { name: "Ra", value: found.Ra, unit: sign, sigma: found.Ra * scale },
          { name: "Rq", value: found.Rq, unit: sign, sigma: found.Rq * scale },
          { name: "Rt", value: found.Rt, unit: sign, sigma: found.Rt * scale },
          { name: "Pa", value: found.Pa, unit: sign, sigma: found.Pa * scale },
          { name: "Pq", value: found.Pq, unit: sign, sigma: found.Pq * scale },
          { name: "Pt", value: found.Pt, unit: sign, sigma: found.Pt * scale },
        ],
      };
    }
    case "distance": {
      const found = distanceBetween(surface, places[0], places[1]);
      const local = Math.hypot(...places.map((place) => sigmaAt(surface, place)));
      return {
        rows: [
          { name: "In the plane", value: found.lateral, unit: sign },
          { name: "In height", value: found.vertical, unit: sign, sigma: Math.hypot(local, found.vertical * scale), note: "second less first" },
          { name: "In space", value: found.spatial, unit: sign },
        ],
      };
    }
    case "angle":
      return {
        rows: [{ name: "Angle", value: angleAt(surface, places[0], places[1], places[2]), unit: "°", note: "between the straight lines from the corner" }],
      };
    case "step": {
      const found = stepBetween(surface, rectangle(places, 0), rectangle(places, 2));
      if (!found) return none("each region needs three known heights that are not in line; make them larger");
      return {
        rows: [
          { name: "Step height", value: found.height, unit: sign, sigma: Math.abs(found.height * scale), note: "second region above the first" },
          { name: "Perpendicular", value: found.perpendicular, unit: sign, sigma: Math.abs(found.perpendicular * scale), note: "along the planes' normal" },
          { name: "Residual", value: found.residualRms, unit: sign, note: "root mean square of the two parallel planes" },
          { name: "Angle", value: found.angleDeg, unit: "°", note: "between planes fitted to each region" },
        ],
      };
    }
    default: {
      const found = areaAndVolume(surface, rectangle(places, 0), choices.reference);
      if (!found) return none("fewer than three heights are known there; choose a larger region");
      return {
        rows: [
          { name: "Projected area", value: found.projected, unit: `${sign}²` },
          { name: "Developed area", value: found.developed, unit: `${sign}²` },
          { name: "Volume above", value: found.above, unit: `${sign}³`, sigma: found.above * scale },
          { name: "Volume below", value: found.below, unit: `${sign}³`, sigma: found.below * scale },
          { name: "Unknown area", value: found.unknownArea, unit: `${sign}²`, note: "its volume is missing" },
        ],
      };
    }
  }
}

function none(trouble: string): Finding {
  return { rows: [], trouble };
}

/** Return lambda c as chosen, or the round length next below a fifth of the profile's. */
export function nestingIndexOf(choices: Choices, length: number): number {
  return choices.nestingIndex > 0 ? choices.nestingIndex : roundLength(length / 5);
}

/** Return the 1-sigma at a place, of the nearest height; NaN where it is unknown. */
export function sigmaAt(surface: Surface, place: Place): number {
  const col = Math.round(place.x);
  const row = Math.round(place.y);
  if (col < 0 || row < 0 || col >= surface.cols || row >= surface.rows) return NaN;
  return surface.sigmaOfCode[surface.sigmaCode[row * surface.cols + col]];
}

export function rectangle(places: Place[], first: number): Rectangle {
  return { a: places[first], b: places[first + 1] };
}

/** Return a value and its sigma with two digits of the sigma. */
export function valueText(row: Row): string {
  const unit = row.unit ? (row.unit === "°" ? row.unit : ` ${row.unit}`) : "";
  if (row.sigma === undefined || !(row.sigma > 0)) return `${number(row.value)}${unit}`;
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(row.sigma)));
  if (decimals > 12) return `${number(row.value)}${unit}`;
  return `${row.value.toFixed(decimals).replace("-", "−")} ± ${row.sigma.toFixed(decimals)}${unit}`;
}

type Find = (x: number, y: number) => [number, number] | null;

/** Draw a tool's marks; `find` tells where a place of the grid is in the view, `dense` to follow the surface. */
export function drawMarks(pen: Pen2D, ink: Ink, tool: Tool, places: Place[], cursor: Place | null, find: Find, dense: boolean): void {
  const waiting = cursor && places.length && places.length < tool.asks ? [...places, cursor] : places;
  const path = (from: Place, to: Place): ([number, number] | null)[] => {
    const steps = dense ? Math.min(400, Math.max(1, Math.ceil(Math.hypot(to.x - from.x, to.y - from.y)))) : 1;
    return Array.from({ length: steps + 1 }, (_, i) =>
      find(from.x + (i / steps) * (to.x - from.x), from.y + (i / steps) * (to.y - from.y)),
    );
  };
  if (tool.rectangles) {
    for (let k = 0; k + 1 < waiting.length; k += 2) {
      const [a, b] = [waiting[k], waiting[k + 1]];
      const corners = [a, { x: b.x, y: a.y }, b, { x: a.x, y: b.y }, a];
      const colour = k ? ink.second : ink.accent;
      for (let i = 0; i < 4; i++) drawPath(pen, ink, path(corners[i], corners[i + 1]), colour);
    }
  } else {
    for (let k = 0; k + 1 < waiting.length; k++) drawPath(pen, ink, path(waiting[k], waiting[k + 1]), ink.accent);
  }
  places.forEach((place, i) => {
    const at = find(place.x, place.y);
    const name = tool.rectangles ? (i % 2 ? "" : tool.asks > 2 ? String(i / 2 + 1) : "") : "ABC"[i];
    if (at) drawDot(pen, ink, at, tool.rectangles && i > 1 ? ink.second : ink.accent, name);
  });
}

/** Draw the linked cursor. */
export function drawCursor(pen: Pen2D, ink: Ink, at: [number, number], text = ""): void {
  const [x, y] = at;
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
  if (text) {
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    label(pen, ink, text, x + 10, y - 8);
  }
}

/** Return a profile as lines of text for a spreadsheet. */
export function profileCsv(surface: Surface, profile: Profile, from: Place, to: Place): string {
  const lines = [`distance_${surface.unit},height_${surface.unit},sigma_${surface.unit}`];
  const last = profile.distance.length - 1;
  profile.distance.forEach((distance, i) => {
    const share = i / Math.max(1, last);
    const sigma = sigmaAt(surface, { x: from.x + share * (to.x - from.x), y: from.y + share * (to.y - from.y) });
    const text = (value: number): string => (Number.isNaN(value) ? "" : String(Number(value.toPrecision(8))));
    lines.push([text(distance), text(profile.height[i]), text(sigma)].join(","));
  });
  return lines.join("\r\n") + "\r\n";
}

export function heightUnder(surface: Surface, place: Place): number {
  return heightAt(surface, place.x, place.y);
}
