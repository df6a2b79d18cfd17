/**
 * The surface in three dimensions. It draws when something has changed and at no other time: at once with at most
 * about 180,000 triangles, and when nothing has moved for a moment at full resolution, in slices that leave the page
 * responsive.
 */

import { Vector3 } from "three";
import { COLOUR_BAR_PX, penOf, type Pen2D } from "./annotate";
import { cameraOf, fitted, type Eye } from "./camera";
import { drawOver3D, type Project } from "./overlay3d";
import { Painter, type Camera, type Look } from "./painter";
import { pickHeight } from "./pick";
import { opaquePicture } from "./picture";
import { cameraDistance, cameraPlace } from "./scene";
import type { Facts } from "./settings";
import { Space } from "./space";
import type { Surface } from "./types";

const STILL_AFTER_MS = 160;
const SLICE_MS = 40;
const EYE_TURN_DEG = 1.6;
/** A picture that takes longer is not smoothed while something moves, until one without takes half of this. */
const SMOOTH_WITHIN_MS = 80;

export class View3D {
  readonly canvas = document.createElement("canvas");
  readonly overlay = document.createElement("canvas");
  readonly firstPicture: Promise<void>;
  /** Draws the tools' marks over the picture. */
  marks: (pen: Pen2D, project: Project) => void = () => undefined;
  /** Told when a picture is on the screen: "moving" or "still". */
  onPicture: (kind: "moving" | "still", triangles: number) => void = () => undefined;

  private readonly space: Space;
  private readonly painter: Painter;
  private frame = 0;
  private still = 0;
  private job = 0;
  private smooth = false;
  private drawn: () => void = () => undefined;
  private readonly sizeWatch: ResizeObserver;
  private disposed = false;

  constructor(
    private readonly surface: Surface,
    private readonly facts: Facts,
    grey: Uint8Array | null,
    private readonly look: Look,
  ) {
    this.canvas.className = "sv-canvas";
    this.overlay.className = "sv-overlay";
    this.space = new Space(surface, facts.shown, () => look.settings().exaggeration);
    this.painter = new Painter(this.canvas, surface, facts, grey, this.space, look);
    this.firstPicture = new Promise((resolve) => (this.drawn = resolve));
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.painter.rebuild();
      this.redraw();
    });
    // The observer also speaks when it begins, though the picture may be drawn by then.
    this.sizeWatch = new ResizeObserver(() => this.painter.isFitted() || this.redraw());
    this.sizeWatch.observe(this.canvas);
  }

  /** Ask for a new picture. */
  redraw(): void {
    this.job++;
    window.clearTimeout(this.still);
    if (this.disposed || this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.drawMoving();
    });
  }

  /** Draw letters and marks again, but not the surface. */
  annotate(): void {
    const pen = penOf(this.overlay);
    if (pen) this.drawOver(pen);
  }

  /** Return an eye brought to where it just sees the whole surface, and the cameras of the series where they are shown. */
  fitted(eye: Eye): Eye {
    const { rows, cols } = this.surface;
    const corners = [0, cols - 1].flatMap((x) => [0, rows - 1].flatMap((y) => this.facts.shown.map((z) => this.space.toScene(x, y, z))));
    // Room for the colour bar and the axes' letters beside it.
    const width = Math.max(1, this.canvas.clientWidth - COLOUR_BAR_PX - 40);
    const distance = cameraDistance(this.surface, this.space.top());
    const { cameras } = this.look.settings();
    // Their tilts are written above them.
    if (cameras) corners.push(...this.surface.cameras.map((camera) => cameraPlace(camera.rotation, 1.15 * distance)));
    return fitted(eye, corners, width / Math.max(1, this.canvas.clientHeight));
  }

  /** Return where in the grid the surface is seen at a place of the view in CSS px, and its height; null beside it. */
  pick(x: number, y: number): [number, number, number] | null {
    const camera = this.camera();
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    const at = (depth: number): Vector3 =>
      this.space.toGrid(new Vector3((2 * x) / width - 1, 1 - (2 * y) / height, depth).unproject(camera));
    return pickHeight(this.surface, this.facts.range, at(-1), at(1));
  }

  /** Return where a height of the grid is in the view, in CSS px; null where it is behind the eye or unknown. */
  toScreen(x: number, y: number): [number, number] | null {
    return this.project(this.camera())(x, y, this.surface.height[y * this.surface.cols + x]);
  }

  /** Return a PNG of what is seen, on an opaque ground. */
  async picture(ground: string): Promise<Blob> {
    this.job++;
    this.painter.paint(this.passes(), this.painter.fineStride(), true);
    return opaquePicture(this.canvas, ground, (pen) => this.drawOver(pen));
  }

  dispose(): void {
    this.disposed = true;
    this.job++;
    cancelAnimationFrame(this.frame);
    window.clearTimeout(this.still);
    this.sizeWatch.disconnect();
    this.painter.dispose();
  }

  private drawMoving(): void {
    if (!this.painter.fit()) return;
    const start = performance.now();
    const stride = this.painter.movingStride();
    const { smooth } = this;
    const triangles = this.painter.paint(this.passes(), stride, smooth);
    this.annotate();
    this.onPicture("moving", triangles);
    const job = this.job;
    void this.painter.finished().then(() => {
      // What is drawn now is on the screen when the next frame begins.
      requestAnimationFrame(() => this.drawn());
      this.smooth = performance.now() - start < (smooth ? SMOOTH_WITHIN_MS : SMOOTH_WITHIN_MS / 2);
      if (job !== this.job) return;
      if (smooth && this.painter.fineStride() >= stride) this.onPicture("still", triangles);
      else this.still = window.setTimeout(() => void this.drawStill(++this.job), STILL_AFTER_MS);
    });
  }

  /** Draw at full resolution, a slice for each frame, and show the picture when it is complete. */
  private async drawStill(job: number): Promise<void> {
    const stride = this.painter.fineStride();
    let triangles = 0;
    const passes = this.passes();
    let perSlice = 24;
    for (const [index, camera] of passes.entries()) {
      const tiles = this.painter.tiles(stride, camera);
      this.painter.begin(index, true);
      for (let done = 0; done < tiles.length; ) {
        const start = performance.now();
        const slice = tiles.slice(done, done + 2 * perSlice);
        triangles += this.painter.surfaceTiles(slice, stride, camera);
        done += slice.length;
        await this.painter.finished();
        if (job !== this.job) return;
        const spent = performance.now() - start;
        perSlice = Math.round(Math.min(512, Math.max(8, perSlice * Math.min(2, Math.max(0.5, SLICE_MS / spent)))));
      }
      this.painter.extras(camera);
    }
    this.painter.show(passes, true);
    this.onPicture("still", triangles);
  }

  private camera(turnDeg = 0): Camera {
    const { clientWidth, clientHeight } = this.canvas;
    const camera = cameraOf(this.look.settings().eye, clientWidth / Math.max(1, clientHeight), turnDeg);
    if (this.look.colouring().by !== "micrograph") {
      camera.setViewOffset(clientWidth, clientHeight, COLOUR_BAR_PX / 2, 0, clientWidth, clientHeight);
    }
    return camera;
  }

  private passes(): Camera[] {
    return this.look.settings().anaglyph ? [this.camera(-EYE_TURN_DEG), this.camera(EYE_TURN_DEG)] : [this.camera()];
  }

  private project(camera: Camera): Project {
    const { clientWidth, clientHeight } = this.canvas;
    const at = new Vector3();
    return (x, y, z) => {
      if (Number.isNaN(z)) return null;
      this.space.toScene(x, y, z, at).project(camera);
      return Math.abs(at.z) <= 1 ? [((at.x + 1) / 2) * clientWidth, ((1 - at.y) / 2) * clientHeight] : null;
    };
  }

  private drawOver(pen: Pen2D): void {
    const { clientWidth, clientHeight } = this.canvas;
    const camera = this.camera();
    drawOver3D(pen, this.look, this.surface, this.facts, {
      width: clientWidth,
      height: clientHeight,
      scale: this.space.scale,
      camera,
      cameraDistance: cameraDistance(this.surface, this.space.top()),
      project: this.project(camera),
      marks: this.marks,
    });
  }
}
