/** How finely a surface is drawn, and which parts of it. */

import { Box3, Frustum, Matrix4, type Camera, type Vector3 } from "three";
import type { Settings } from "./settings";
import type { Surface } from "./types";

const MOVING_TRIANGLES = 180_000;
const MOVING_POINTS = 180_000;
/** Finer than this share of a pixel of the screen no cell is drawn. */
const FINEST_CELL_PX = 0.35;
const LEAST_POINT_DISTANCE_PX = 2;
const LEAST_LINE_DISTANCE_PX = 9;

/** Return n, of which every n-th row and column is drawn while something moves; a cell is `cellPx` wide on the screen. */
export function movingStride(surface: Surface, settings: Settings, cellPx: number): number {
  const most = settings.style === "points" ? MOVING_POINTS : MOVING_TRIANGLES / 2 / (settings.anaglyph ? 2 : 1);
  return Math.max(fineStride(settings, cellPx), Math.ceil(Math.sqrt((surface.rows * surface.cols) / most)));
}

/** The same when all is still: every one, as far as the screen can show it. */
export function fineStride(settings: Settings, cellPx: number): number {
  let stride = 1;
  if (settings.style === "points") while (cellPx * stride < LEAST_POINT_DISTANCE_PX) stride++;
  else while (2 * cellPx * stride < FINEST_CELL_PX) stride *= 2;
  return stride;
}

/** Lines of a wireframe are so many rows and columns apart. */
export function wireStride(cellPx: number): number {
  let stride = 1;
  while (cellPx * stride < LEAST_LINE_DISTANCE_PX) stride *= 2;
  return stride;
}

/** Return the corners, x y x y, of the square tiles of `side` cells that a camera may see. */
export function tilesSeen(
  surface: Surface, [low, high]: [number, number], side: number, camera: Camera,
  toScene: (x: number, y: number, height: number, out: Vector3) => Vector3,
): Float32Array {
  const { rows, cols } = surface;
  const seen = new Frustum().setFromProjectionMatrix(
    new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse),
  );
  const found: number[] = [];
  const box = new Box3();
  for (let y = 0; y < rows - 1; y += side) {
    for (let x = 0; x < cols - 1; x += side) {
      toScene(x, Math.min(y + side, rows - 1), low, box.min);
      toScene(Math.min(x + side, cols - 1), y, high, box.max);
      if (seen.intersectsBox(box)) found.push(x, y);
    }
  }
  return Float32Array.from(found);
}
