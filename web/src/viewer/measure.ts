/** Measures of a surface, with the definitions of semscape.metrology (docs/metrology.md), on the heights as shown. */

import { heightAt } from "./grid";
import { partOf, type Part, type Ring } from "./region";
import type { Place, Surface } from "./types";

export interface Profile {
  /** Distance from the start, evenly spaced by `step`. */
  distance: Float64Array;
  /** NaN is unknown. */
  height: Float64Array;
  step: number;
}

const GAUSSIAN_ALPHA = Math.sqrt(Math.LN2 / Math.PI);

/** Return the heights along a line, bilinear, spaced by about a pixel so that the last one is the line's end. */
export function extractProfile(surface: Surface, start: Place, end: Place): Profile {
  const length = Math.hypot(end.x - start.x, end.y - start.y) * surface.pixelSize;
  const count = Math.max(Math.round(length / surface.pixelSize), 1);
  const distance = new Float64Array(count + 1);
  const height = new Float64Array(count + 1);
  for (let i = 0; i <= count; i++) {
    const share = i / count;
    distance[i] = share * length;
    height[i] = heightAt(surface, start.x + share * (end.x - start.x), start.y + share * (end.y - start.y));
  }
  return { distance, height, step: length / count };
}

export interface ProfileFigures {
  Pa: number;
  Pq: number;
  Pt: number;
  Ra: number;
  Rq: number;
  Rt: number;
}

/**
 * Return Pa, Pq and Pt of the profile without its least-squares line; with a nesting index (lambda c) Ra, Rq and Rt of
 * what the Gaussian mean line leaves, without half a nesting index at each end. Null where fewer than 8 heights are known.
 */
export function profileFigures(profile: Profile, nestingIndex: number): ProfileFigures | null {
  const primary = withoutLine(profile);
  if (!primary) return null;
  const [Pa, Pq, Pt] = spread(primary);
  const travel = Math.round(nestingIndex / 2 / profile.step);
  const smooth = meanLine(primary, profile.step, nestingIndex);
  const rough = primary.map((z, i) => z - smooth[i]).slice(travel, Math.max(travel, primary.length - travel));
  const [Ra, Rq, Rt] = spread(rough);
  return { Pa, Pq, Pt, Ra, Rq, Rt };
}

function withoutLine(profile: Profile): Float64Array | null {
  let n = 0;
  let sumX = 0;
  let sumZ = 0;
  const { distance, height } = profile;
  for (let i = 0; i < height.length; i++) {
    if (Number.isNaN(height[i])) continue;
    n++;
    sumX += distance[i];
    sumZ += height[i];
  }
  if (n < 8) return null;
  const meanX = sumX / n;
  const meanZ = sumZ / n;
  let xx = 0;
  let xz = 0;
  for (let i = 0; i < height.length; i++) {
    if (Number.isNaN(height[i])) continue;
    xx += (distance[i] - meanX) ** 2;
    xz += (distance[i] - meanX) * (height[i] - meanZ);
  }
  return height.map((z, i) => z - meanZ - (xx ? xz / xx : 0) * (distance[i] - meanX));
}

/** Return the Gaussian mean line of ISO 16610-21, normalized by what is known beneath the window. */
function meanLine(z: Float64Array, step: number, nestingIndex: number): Float64Array {
  const length = nestingIndex / step;
  const reach = Math.min(Math.ceil(length), z.length - 1);
  const weights = Float64Array.from({ length: reach + 1 }, (_, k) =>
    Math.exp(-Math.PI * (k / (GAUSSIAN_ALPHA * length)) ** 2),
  );
  return z.map((here, i) => {
    if (Number.isNaN(here)) return NaN;
    let sum = 0;
    let weight = 0;
    const last = Math.min(i + reach, z.length - 1);
    for (let j = Math.max(0, i - reach); j <= last; j++) {
      if (Number.isNaN(z[j])) continue;
      const w = weights[Math.abs(i - j)];
      sum += w * z[j];
      weight += w;
    }
    return sum / weight;
  });
}

/** Return mean size, root mean square and extent of the known values. */
function spread(z: Float64Array): [number, number, number] {
  let n = 0;
  let sum = 0;
  let squares = 0;
  let low = Infinity;
  let high = -Infinity;
  for (const value of z) {
    if (Number.isNaN(value)) continue;
    n++;
    sum += Math.abs(value);
    squares += value * value;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return n ? [sum / n, Math.sqrt(squares / n), high - low] : [NaN, NaN, NaN];
}

export interface Distance {
  lateral: number;
  vertical: number;
  spatial: number;
}

/** Return the distance of two places of the surface; vertical is the second less the first. */
export function distanceBetween(surface: Surface, first: Place, second: Place): Distance {
  const lateral = Math.hypot(second.x - first.x, second.y - first.y) * surface.pixelSize;
  const vertical = heightAt(surface, second.x, second.y) - heightAt(surface, first.x, first.y);
  return { lateral, vertical, spatial: Math.hypot(lateral, vertical) };
}

/** Return the angle in deg at `corner` between the straight lines to two other places of the surface. */
export function angleAt(surface: Surface, first: Place, corner: Place, last: Place): number {
  const from = (place: Place): [number, number, number] => [
    (place.x - corner.x) * surface.pixelSize,
    (place.y - corner.y) * surface.pixelSize,
    heightAt(surface, place.x, place.y) - heightAt(surface, corner.x, corner.y),
  ];
  return degreesBetween(from(first), from(last));
}

function degreesBetween(a: [number, number, number], b: [number, number, number]): number {
  const across = Math.hypot(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
  return (Math.atan2(across, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) * 180) / Math.PI;
}

/** A plane z = offset + slopeX (x - x0) + slopeY (y - y0) over the grid in units of length, y down. */
export interface Plane {
  offset: number;
  slopeX: number;
  slopeY: number;
  x0: number;
  y0: number;
  count: number;
}

/** Fit a plane by least squares along z to a part's known heights, those alone that `among` accepts; null of fewer than 3. */
export function fitPlane(surface: Surface, part: Part, among: (row: number, col: number) => boolean = part.has): Plane | null {
  const { row0, row1, col0, col1 } = part;
  const { cols, height, pixelSize } = surface;
  const x0 = ((col0 + col1) / 2) * pixelSize;
  const y0 = ((row0 + row1) / 2) * pixelSize;
  let n = 0;
  let sx = 0, sy = 0, sz = 0, sxx = 0, sxy = 0, syy = 0, sxz = 0, syz = 0;
  for (let row = row0; row <= row1; row++) {
    const y = row * pixelSize - y0;
    for (let col = col0; col <= col1; col++) {
      const z = height[row * cols + col];
      if (Number.isNaN(z) || !among(row, col)) continue;
      const x = col * pixelSize - x0;
      n++;
      sx += x;
      sy += y;
      sz += z;
      sxx += x * x;
      sxy += x * y;
      syy += y * y;
      sxz += x * z;
      syz += y * z;
    }
  }
  if (n < 3) return null;
  const mx = sx / n, my = sy / n, mz = sz / n;
  const xx = sxx / n - mx * mx, yy = syy / n - my * my, xy = sxy / n - mx * my;
  const xz = sxz / n - mx * mz, yz = syz / n - my * mz;
  const determinant = xx * yy - xy * xy;
  if (!(determinant > 1e-12 * xx * yy)) return null;
  const slopeX = (xz * yy - yz * xy) / determinant;
  const slopeY = (yz * xx - xz * xy) / determinant;
  return { offset: mz - slopeX * mx - slopeY * my, slopeX, slopeY, x0, y0, count: n };
}

export function planeAt(plane: Plane, x: number, y: number): number {
  return plane.offset + plane.slopeX * (x - plane.x0) + plane.slopeY * (y - plane.y0);
}

/** Angle of a plane's steepest line to the horizontal, in deg. */
export function planeTiltDeg(plane: Plane): number {
  return (Math.atan(Math.hypot(plane.slopeX, plane.slopeY)) * 180) / Math.PI;
}

export interface StepFigures {
  /** Second region above the first, along z. */
  height: number;
  /** The same along the planes' normal. */
  perpendicular: number;
  residualRms: number;
  /** Angle between planes fitted to each region alone. */
  angleDeg: number;
}

/** Return the step between two regions by two parallel planes, as semscape.metrology.step has it; null without heights. */
export function stepBetween(surface: Surface, first: Ring, second: Ring): StepFigures | null {
  const { cols, height, pixelSize } = surface;
  const parts = [partOf(surface, first), partOf(surface, second)];
  const moments = parts.map((part) => {
    const m = { n: 0, x: 0, y: 0, z: 0, xx: 0, xy: 0, yy: 0, xz: 0, yz: 0, zz: 0 };
    for (let row = part.row0; row <= part.row1; row++) {
      for (let col = part.col0; col <= part.col1; col++) {
        const z = height[row * cols + col];
        if (Number.isNaN(z) || !part.has(row, col)) continue;
        m.n++;
        m.x += col * pixelSize;
        m.y += row * pixelSize;
        m.z += z;
      }
    }
    return m;
  });
  const [one, two] = moments;
  if (one.n < 3 || two.n < 3) return null;
  // Each region about its own mean: what is left are the common slopes; the means then tell the step.
  const within = { xx: 0, xy: 0, yy: 0, xz: 0, yz: 0, zz: 0 };
  parts.forEach((part, which) => {
    const m = moments[which];
    const mx = m.x / m.n, my = m.y / m.n, mz = m.z / m.n;
    for (let row = part.row0; row <= part.row1; row++) {
      for (let col = part.col0; col <= part.col1; col++) {
        const value = height[row * cols + col];
        if (Number.isNaN(value) || !part.has(row, col)) continue;
        const x = col * pixelSize - mx, y = row * pixelSize - my, z = value - mz;
        within.xx += x * x;
        within.xy += x * y;
        within.yy += y * y;
        within.xz += x * z;
        within.yz += y * z;
        within.zz += z * z;
      }
    }
  });
  const determinant = within.xx * within.yy - within.xy ** 2;
  if (!(determinant > 1e-12 * within.xx * within.yy)) return null;
  const slopeX = (within.xz * within.yy - within.yz * within.xy) / determinant;
  const slopeY = (within.yz * within.xx - within.xz * within.xy) / determinant;
  const rise =
    two.z / two.n - one.z / one.n - slopeX * (two.x / two.n - one.x / one.n) - slopeY * (two.y / two.n - one.y / one.n);
  const left = within.zz - slopeX * within.xz - slopeY * within.yz;
  const planes = parts.map((part) => fitPlane(surface, part));
  const normal = (plane: Plane): [number, number, number] => [-plane.slopeX, -plane.slopeY, 1];
  return {
    height: rise,
    perpendicular: rise / Math.sqrt(1 + slopeX ** 2 + slopeY ** 2),
    residualRms: Math.sqrt(Math.max(0, left) / (one.n + two.n)),
    angleDeg: planes[0] && planes[1] ? degreesBetween(normal(planes[0]), normal(planes[1])) : NaN,
  };
}
