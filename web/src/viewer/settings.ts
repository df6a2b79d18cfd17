/** What a user can set of the views: plain JSON, kept over a reload. */

import { HOME, type Eye } from "./camera";
import { colourTable, type ColourBy, type Colouring } from "./colours";
import { heightRange, percentiles } from "./grid";
import { decimalsOf, fixed, number, ticks, tickStep, unitSign } from "./numbers";
import type { Surface } from "./types";

export interface Settings {
  colourBy: ColourBy;
  colourMap: "viridis" | "cividis";
  style: "surface" | "wireframe" | "points";
  exaggeration: number;
  lightAzimuthDeg: number;
  lightAltitudeDeg: number;
  shaded: boolean;
  anaglyph: boolean;
  cameras: boolean;
  sparse: boolean;
  axes: boolean;
  eye: Eye;
}

export const DEFAULTS: Readonly<Settings> = {
  colourBy: "height",
  colourMap: "viridis",
  style: "surface",
  exaggeration: 1,
  lightAzimuthDeg: 315,
  lightAltitudeDeg: 45,
  shaded: true,
  anaglyph: false,
  cameras: false,
  sparse: false,
  axes: true,
  eye: HOME,
};

/** Return settings of an earlier time, each only where it is of the kind it should be. */
export function restored(kept: unknown): Settings {
  const found: Record<string, unknown> = { ...DEFAULTS };
  if (typeof kept === "object" && kept !== null) {
    for (const [key, value] of Object.entries(kept)) {
      if (key in DEFAULTS && key !== "eye" && typeof value === typeof found[key]) found[key] = value;
    }
    const eye = (kept as { eye?: Partial<Eye> }).eye;
    const numbers = [eye?.azimuthDeg, eye?.elevationDeg, eye?.reach, ...(Array.isArray(eye?.target) ? eye.target : [NaN])];
    if (eye && numbers.length === 6 && numbers.every((value) => Number.isFinite(value))) found.eye = { ...HOME, ...eye };
  }
  const settings = found as unknown as Settings;
  if (!["micrograph", "height", "sigma", "views"].includes(settings.colourBy)) settings.colourBy = "height";
  if (!["surface", "wireframe", "points"].includes(settings.style)) settings.style = "surface";
  if (!["viridis", "cividis"].includes(settings.colourMap)) settings.colourMap = "viridis";
  return settings;
}

/** What is worked out once of a surface. */
export interface Facts {
  /** Lowest and highest height. */
  range: [number, number];
  /** Without the outermost half percent, for colours. */
  shown: [number, number];
  /** Codes of the sigmas, likewise. */
  sigmaCodes: [number, number];
  mostViews: number;
  hasSigma: boolean;
  known: number;
}

export function factsOf(surface: Surface): Facts {
  const [low, high] = percentiles(surface.height, [0.005, 0.995]);
  const counts = new Uint32Array(256);
  let mostViews = 0;
  for (let i = 0; i < surface.nViews.length; i++) {
    counts[surface.sigmaCode[i]]++;
    if (surface.nViews[i] > mostViews) mostViews = surface.nViews[i];
  }
  const known = surface.sigmaCode.length - counts[0];
  const [sigmaLow, sigmaHigh] = [0.01, 0.99].map((share) => codeAt(counts, share * (known - counts[1])));
  return {
    range: heightRange(surface.height),
    shown: high > low ? [low, high] : [(low || 0) - 0.5, (low || 0) + 0.5],
    sigmaCodes: sigmaHigh > sigmaLow ? [sigmaLow, sigmaHigh] : [(sigmaLow || 2) - 1, (sigmaLow || 2) + 1],
    mostViews,
    hasSigma: Number.isFinite(sigmaLow),
    known,
  };
}

/** Return the code of a sigma that so many heights are at or below; NaN where none is known. */
function codeAt(counts: Uint32Array, rank: number): number {
  let below = 0;
  for (let code = 2; code < counts.length; code++) {
    below += counts[code];
    if (below && below >= rank) return code;
  }
  return NaN;
}

/** Return what the colours of the settings mean. */
export function colouringOf(settings: Settings, surface: Surface, facts: Facts): Colouring {
  const sign = unitSign(surface.unit);
  if (settings.colourBy === "sigma") {
    const [low, high] = facts.sigmaCodes;
    const sigma = (code: number): number => surface.sigmaOfCode[2] * (surface.sigmaOfCode[3] / surface.sigmaOfCode[2]) ** (code - 2);
    const marks = Array.from({ length: 5 }, (_, i) => low + (i / 4) * (high - low));
    return {
      by: "sigma",
      title: `1 σ (${sign})`,
      low,
      high,
      table: colourTable("magma"),
      marks: marks.map((at) => ({ at, text: number(sigma(at), 2) })),
      steps: false,
    };
  }
  if (settings.colourBy === "views") {
    const high = Math.max(1, facts.mostViews);
    const every = Math.ceil(high / 8);
    const marks = Array.from({ length: high }, (_, i) => i + 1).filter((n) => n % every === 0 || n === high);
    return {
      by: "views",
      title: "Views",
      low: 0.5,
      high: high + 0.5,
      table: stepped(colourTable(settings.colourMap), high),
      marks: marks.map((at) => ({ at, text: String(at) })),
      steps: true,
    };
  }
  const [low, high] = facts.shown;
  const marks = ticks(low, high, 5);
  const decimals = decimalsOf(tickStep(low, high, 5));
  return {
    by: settings.colourBy,
    title: `Height (${sign})`,
    low,
    high,
    table: colourTable(settings.colourMap),
    marks: marks.map((at) => ({ at, text: fixed(at, decimals) })),
    steps: false,
  };
}

function stepped(table: Uint8Array, count: number): Uint8Array {
  return table.map((_, i) => {
    const step = Math.min(count - 1, Math.floor((Math.floor(i / 3) / 256) * count));
    const from = count > 1 ? Math.round((255 * step) / (count - 1)) : 128;
    return table[3 * from + (i % 3)];
  });
}
