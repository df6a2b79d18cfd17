/** What the line below the views says. */

import { worldAt } from "./grid";
import { decimalsOf, fixed, number, unitSign } from "./numbers";
import { sigmaAt } from "./tools";
import type { Place, Surface } from "./types";

/** Return names and values of what is known at a height of the grid. */
export function cursorText(surface: Surface, cursor: Place): [string, string][] {
  const sign = unitSign(surface.unit);
  const i = cursor.y * surface.cols + cursor.x;
  const z = surface.height[i];
  const [x, y, worldZ] = worldAt(surface, cursor.x, cursor.y, z);
  const decimals = Math.min(6, decimalsOf(surface.pixelSize / 2));
  const sigma = sigmaAt(surface, cursor);
  const zDecimals = sigma > 0 ? Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(sigma)))) : decimals + 1;
  const known = Number.isFinite(z);
  const why = surface.reason ? surface.reasonNames[surface.reason[i]] : undefined;
  const height = `${fixed(worldZ, zDecimals)} ± ${sigma > 0 ? sigma.toFixed(zDecimals) : "?"} ${sign}`;
  const parts: [string, string][] = [
    ["x", `${fixed(x, decimals)} ${sign}`],
    ["y", `${fixed(y, decimals)} ${sign}`],
    ["z", known ? height : why ? `unknown (${why})` : "unknown"],
  ];
  if (known && surface.nViews[i]) parts.push(["views", String(surface.nViews[i])]);
  parts.push(["px", `${cursor.x * surface.stride}, ${cursor.y * surface.stride}`]);
  return parts;
}

/** Return what the surface is, for a line without a cursor. */
export function surfaceText(surface: Surface, known: number): string {
  const share = (100 * known) / Math.max(1, surface.rows * surface.cols);
  const [rows, cols] = surface.fullShape;
  const thinned = surface.stride > 1 ? `, of which every ${ordinal(surface.stride)} row and column is here` : "";
  const spacing = `${number(surface.pixelSize / surface.stride, 4)} ${unitSign(surface.unit)}`;
  return `${cols} × ${rows} heights${thinned}, ${fixed(share, 1)} % known, ${spacing} apart`;
}

function ordinal(n: number): string {
  return n === 2 ? "second" : n === 3 ? "third" : `${n}th`;
}
