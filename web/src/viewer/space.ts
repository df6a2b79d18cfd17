/** Where the grid is in the scene, whose length of 1 is the longer side of the map, and whose middle is at 0. */

import { Vector3 } from "three";
import type { Surface } from "./types";

export class Space {
  /** Length of the scene per unit of length of the surface. */
  readonly scale: number;
  /** Height at the middle of the scene. */
  readonly middle: number;

  constructor(
    private readonly surface: Surface,
    /** Lowest and highest height that are shown; half way between them is the middle of the scene. */
    private readonly shown: [number, number],
    private readonly exaggeration: () => number,
  ) {
    this.middle = 0.5 * (shown[0] + shown[1]);
    this.scale = 1 / (Math.max(surface.rows, surface.cols) * surface.pixelSize);
  }

  /** Length of the scene per unit of height. */
  lift(): number {
    return this.scale * this.exaggeration();
  }

  /** Where the highest height is in the scene. */
  top(): number {
    return (this.shown[1] - this.middle) * this.lift();
  }

  toScene(x: number, y: number, height: number, out = new Vector3()): Vector3 {
    const { rows, cols, pixelSize } = this.surface;
    const cell = pixelSize * this.scale;
    return out.set((x - (cols - 1) / 2) * cell, ((rows - 1) / 2 - y) * cell, (height - this.middle) * this.lift());
  }

  toGrid(point: Vector3): Vector3 {
    const { rows, cols, pixelSize } = this.surface;
    const cell = pixelSize * this.scale;
    return new Vector3(point.x / cell + (cols - 1) / 2, (rows - 1) / 2 - point.y / cell, point.z / this.lift() + this.middle);
  }
}
