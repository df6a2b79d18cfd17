/** The measuring tools: what each asks for, and what it finds. */

import { canClose, closedRings, isComplete, openPlaces, type Marks, type Shape } from "./marks";
import { angleAt, distanceBetween, extractProfile, profileFigures, stepBetween, type Profile } from "./measure";
import { areaAndVolume, arealFigures, type VolumeReference } from "./measure_area";
import { number, roundLength, unitSign } from "./numbers";
import type { Place, Surface } from "./types";

export type ToolName = "inspect" | "profile" | "distance" | "angle" | "step" | "region" | "texture";

export interface Tool {
  name: ToolName;
  title: string;
  /** Points it asks for. */
  points: number;
  /** Regions it asks for. */
  regions: number;
  /** What to do next, for each number of points that are set. */
  hints: string[];
  icon: string;
}

const POINTS_DONE = "Drag a point to change it";

export const TOOLS: Tool[] = [
  { name: "inspect", title: "Inspect", points: 0, regions: 0, icon: "M12 3v5m0 8v5M3 12h5m8 0h5", hints: ["Point at a place to read its height; drag to turn or move the view"] },
  { name: "profile", title: "Profile", points: 2, regions: 0, icon: "M3 16l4-6 4 4 4-8 3 6 3-2", hints: ["Mark the start of the line", "Mark its end", "Drag an end to change the line"] },
  { name: "distance", title: "Distance", points: 2, regions: 0, icon: "M5 19L19 5M4 14l6 6M14 4l6 6", hints: ["Mark the first point", "Mark the second point", POINTS_DONE] },
  { name: "angle", title: "Angle", points: 3, regions: 0, icon: "M4 19h17M4 19L17 5M12 19a9 9 0 0 0-2.5-6", hints: ["Mark a point on the first leg", "Mark the corner", "Mark a point on the second leg", POINTS_DONE] },
  { name: "step", title: "Step", points: 0, regions: 2, icon: "M3 18h8V7h10", hints: [] },
  { name: "region", title: "Area and volume", points: 0, regions: 1, icon: "M4 8l8-4 8 4v8l-8 4-8-4zM4 8l8 4 8-4M12 12v8", hints: [] },
  { name: "texture", title: "ISO 25178", points: 0, regions: 1, icon: "M3 8q3-5 6 0t6 0 6 0M3 16q3-5 6 0t6 0 6 0", hints: [] },
];

/** Return what to do next. */
export function hintOf(tool: Tool, shape: Shape, marks: Marks): string {
  if (!tool.regions) return tool.hints[Math.min(marks.places.length, tool.hints.length - 1)];
  if (isComplete(tool, marks)) return "Drag a corner to change the region";
  const which = tool.regions > 1 ? `${marks.ends.length ? "Second" : "First"} region: ` : "";
  const whole = tool.name === "texture" && !marks.places.length ? "The whole surface. For a region: " : "";
  const open = openPlaces(marks).length;
  const next =
    shape === "rectangle" ? (open ? "mark the opposite corner" : "mark a corner")
    : canClose(tool, shape, marks) ? "mark the next corner, or close it: double click, or click its first corner"
    : open ? "mark the next corner" : "mark its corners one after the other";
  const hint = which + whole + next;
  return hint[0].toUpperCase() + hint.slice(1);
}

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
  /** How regions are drawn. */
  shape: Shape;
}

/** Return what a tool finds at its marks; null as long as it waits for more. */
export function finding(tool: Tool, surface: Surface, marks: Marks, choices: Choices): Finding | null {
  const { places } = marks;
  const [first, second] = closedRings(marks);
  const sign = unitSign(surface.unit);
  const scale = surface.heightScaleRelativeSigma ?? NaN;
  if (tool.name === "texture") {
    if (places.length && !first) return null;
    const found = arealFigures(surface, first);
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
  if (tool.name === "inspect" || !isComplete(tool, marks)) return null;
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
      const found = stepBetween(surface, first, second);
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
      const found = areaAndVolume(surface, first, choices.reference);
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

/** Return a value and its sigma with two digits of the sigma. */
export function valueText(row: Row): string {
  const unit = row.unit ? (row.unit === "°" ? row.unit : ` ${row.unit}`) : "";
  if (row.sigma === undefined || !(row.sigma > 0)) return `${number(row.value)}${unit}`;
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(row.sigma)));
  if (decimals > 12) return `${number(row.value)}${unit}`;
  return `${row.value.toFixed(decimals).replace("-", "−")} ± ${row.sigma.toFixed(decimals)}${unit}`;
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
