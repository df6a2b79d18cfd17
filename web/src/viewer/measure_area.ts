/** Areas, volumes and parameters of ISO 25178 of a region, with the definitions of semscape.metrology. */

import { fitPlane, planeAt } from "./measure";
import { isOnRim, partOf, type Ring } from "./region";
import type { Surface } from "./types";

/** What volumes are measured from. */
export type VolumeReference = "rim" | "lowest" | "mean";

export interface AreaFigures {
  projected: number;
  developed: number;
  above: number;
  below: number;
  unknownArea: number;
}

/** Return areas of a region, and the volumes above and below a reference; null where too few heights are known. */
export function areaAndVolume(surface: Surface, ring: Ring, reference: VolumeReference): AreaFigures | null {
  const part = partOf(surface, ring);
  const { row0, row1, col0, col1 } = part;
  const { cols, height, pixelSize } = surface;
  const onRim = (row: number, col: number): boolean => part.has(row, col) && isOnRim(part, row, col);
  const plane = fitPlane(surface, part, reference === "rim" ? onRim : part.has);
  if (!plane) return null;
  let lowest = Infinity;
  for (let row = row0; row <= row1; row++) {
    for (let col = col0; col <= col1; col++) {
      const z = height[row * cols + col];
      if (z < lowest && part.has(row, col)) lowest = z;
    }
  }
  const pixel = pixelSize * pixelSize;
  const found = { projected: 0, developed: 0, above: 0, below: 0, unknownArea: 0 };
  for (let row = row0; row <= row1; row++) {
    for (let col = col0; col <= col1; col++) {
      if (!part.has(row, col)) continue;
      const i = row * cols + col;
      const z = height[i];
      if (Number.isNaN(z)) {
        found.unknownArea += pixel;
        continue;
      }
      const over = z - (reference === "lowest" ? lowest : planeAt(plane, col * pixelSize, row * pixelSize));
      if (over > 0) found.above += over * pixel;
      else found.below -= over * pixel;
      if (part.has(row, col + 1) && part.has(row + 1, col) && part.has(row + 1, col + 1)) {
        const factor = cellStretch(height, i, cols, pixelSize);
        if (factor) {
          found.projected += pixel;
          found.developed += factor * pixel;
        }
      }
    }
  }
  return found;
}

/** Return how much larger a cell's surface is than its projection, over both ways to cut it in two; 0 at a gap. */
function cellStretch(height: Float32Array, i: number, cols: number, pixelSize: number): number {
  const a = height[i], b = height[i + 1], c = height[i + cols], d = height[i + cols + 1];
  const top = ((b - a) / pixelSize) ** 2;
  const bottom = ((d - c) / pixelSize) ** 2;
  const left = ((c - a) / pixelSize) ** 2;
  const right = ((d - b) / pixelSize) ** 2;
  const sum =
    Math.sqrt(1 + top + left) + Math.sqrt(1 + bottom + right) + Math.sqrt(1 + top + right) + Math.sqrt(1 + bottom + left);
  return Number.isNaN(sum) ? 0 : sum / 4;
}

export interface ArealFigures {
  Sa: number;
  Sq: number;
  Ssk: number;
  Sku: number;
  Sp: number;
  Sv: number;
  Sz: number;
  Sdq: number;
  /** In percent. */
  Sdr: number;
  count: number;
}

/** Return parameters of ISO 25178-2 after a least-squares plane is taken off; null where fewer than 3 heights are known. */
export function arealFigures(surface: Surface, ring?: Ring): ArealFigures | null {
  const part = partOf(surface, ring);
  const plane = fitPlane(surface, part);
  if (!plane) return null;
  const { cols, pixelSize } = surface;
  const width = part.col1 - part.col0 + 1;
  const levelled = new Float32Array(width * (part.row1 - part.row0 + 1));
  let sum = 0, squares = 0, cubes = 0, fourths = 0, low = Infinity, high = -Infinity;
  for (let row = part.row0, k = 0; row <= part.row1; row++) {
    for (let col = part.col0; col <= part.col1; col++, k++) {
      const height = part.has(row, col) ? surface.height[row * cols + col] : NaN;
      const z = height - planeAt(plane, col * pixelSize, row * pixelSize);
      levelled[k] = z;
      if (Number.isNaN(z)) continue;
      sum += Math.abs(z);
      squares += z * z;
      cubes += z ** 3;
      fourths += z ** 4;
      if (z < low) low = z;
      if (z > high) high = z;
    }
  }
  const n = plane.count;
  const Sq = Math.sqrt(squares / n);
  const along = [0, 0];
  const pairs = [0, 0];
  let stretch = 0;
  let cells = 0;
  for (let k = 0; k < levelled.length; k++) {
    const lastCol = k % width === width - 1;
    const dx = lastCol ? NaN : levelled[k + 1] - levelled[k];
    const dy = k + width < levelled.length ? levelled[k + width] - levelled[k] : NaN;
    if (dx === dx) { along[0] += dx * dx; pairs[0]++; }
    if (dy === dy) { along[1] += dy * dy; pairs[1]++; }
    if (!lastCol && dy === dy) {
      const factor = cellStretch(levelled, k, width, pixelSize);
      if (factor) { stretch += factor; cells++; }
    }
  }
  return {
    Sa: sum / n,
    Sq,
    Ssk: cubes / n / Sq ** 3,
    Sku: fourths / n / Sq ** 4,
    Sp: high,
    Sv: -low,
    Sz: high - low,
    Sdq: Math.sqrt(along[0] / pairs[0] + along[1] / pairs[1]) / pixelSize,
    Sdr: 100 * (stretch / cells - 1),
    count: n,
  };
}
