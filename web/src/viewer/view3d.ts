/**
 * The surface in three dimensions. It draws when something has changed and at no other time: at once with at most
 * about 180,000 triangles, and when nothing has moved for a moment at full resolution, in slices that leave the page
 * responsive.
 */

import { opaquePicture } from "./picture";
import {
  ColorManagement,
  GLSL3,
  LinearSRGBColorSpace,
  Mesh,
  PlaneGeometry,
  RawShaderMaterial,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
  WebGLRenderTarget,
  type Group,
  type OrthographicCamera,
  type PerspectiveCamera,
  type Points,
} from "three";
import { COLOUR_BAR_PX, drawColourBar, drawScaleBar, penOf, type Ink, type Pen2D } from "./annotate";
import { drawAxes } from "./axes";
import { cameraOf, directionOf, fitted, type Eye } from "./camera";
import type { Colouring } from "./colours";
import { fineStride, movingStride, tilesSeen, wireStride } from "./detail";
import { gridFromWorld } from "./grid";
import { short, unitSign } from "./numbers";
import { pickHeight } from "./pick";
import { cameraFrames, cameraPlace, makeSurfaceScene, PATCH, setTiles, sparsePoints, type SurfaceScene } from "./scene";
import type { Facts, Settings } from "./settings";
import { SCREEN_FRAGMENT, SCREEN_VERTEX } from "./shaders";
import type { Surface } from "./types";

const STILL_AFTER_MS = 160;
const SLICE_MS = 40;
const EYE_TURN_DEG = 1.6;
const KIND_NUMBER = { micrograph: 0, height: 1, sigma: 2, views: 3 } as const;

type Camera = PerspectiveCamera | OrthographicCamera;

/** A place of the surface in the view, in CSS px; null where it is behind the eye or unknown. */
export type Project = (x: number, y: number, height: number) => [number, number] | null;

export class View3D {
  readonly canvas = document.createElement("canvas");
  readonly overlay = document.createElement("canvas");
  readonly firstPicture: Promise<void>;
  /** Draws the tools' marks over the picture. */
  marks: (pen: Pen2D, project: Project) => void = () => undefined;
  /** Told when a picture is on the screen: "moving" or "still". */
  onPicture: (kind: "moving" | "still", triangles: number) => void = () => undefined;

  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly screen: Mesh;
  private readonly screenMaterial: RawShaderMaterial;
  private readonly targets: WebGLRenderTarget[] = [];
  private parts: SurfaceScene;
  private frames: Group | null = null;
  private sparse: Points | null = null;
  private drawnInk = "";
  private frame = 0;
  private still = 0;
  private job = 0;
  private drawn: () => void = () => undefined;
  private readonly sizeWatch: ResizeObserver;
  private disposed = false;
  /** Height at the middle of the scene. */
  private readonly middle: number;

  constructor(
    private readonly surface: Surface,
    private readonly facts: Facts,
    private readonly grey: Uint8Array | null,
    private readonly settings: () => Settings,
    private readonly colouring: () => Colouring,
    private readonly ink: () => Ink,
  ) {
    ColorManagement.enabled = false;
    this.canvas.className = "sv-canvas";
    this.overlay.className = "sv-overlay";
    this.renderer = new WebGLRenderer({ canvas: this.canvas, alpha: true, antialias: false, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.renderer.setClearColor(0x000000, 0);
    const largest = this.renderer.capabilities.maxTextureSize;
    if (Math.max(surface.rows, surface.cols) > largest) {
      this.renderer.dispose();
      throw new Error(`the graphics card takes ${largest} heights a side, the surface has more; the map beside shows all of them`);
    }
    this.middle = 0.5 * (facts.shown[0] + facts.shown[1]);
    this.parts = makeSurfaceScene(surface, grey, this.middle);
    this.screenMaterial = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: SCREEN_VERTEX,
      fragmentShader: SCREEN_FRAGMENT,
      depthTest: false,
      depthWrite: false,
      uniforms: { left: { value: null }, right: { value: null }, anaglyph: { value: 0 } },
    });
    this.screenMaterial.blending = 0;
    this.screen = new Mesh(new PlaneGeometry(2, 2), this.screenMaterial);
    this.screen.frustumCulled = false;
    this.firstPicture = new Promise((resolve) => (this.drawn = resolve));
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => this.rebuild());
    this.sizeWatch = new ResizeObserver(() => this.redraw());
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

  /** Return an eye brought to where it just sees the whole surface. */
  fitted(eye: Eye): Eye {
    const { rows, cols } = this.surface;
    const corners = [0, cols - 1].flatMap((x) => [0, rows - 1].flatMap((y) => this.facts.shown.map((z) => this.toScene(x, y, z, new Vector3()))));
    // Room for the colour bar and the axes' letters beside it.
    const width = Math.max(1, this.canvas.clientWidth - COLOUR_BAR_PX - 40);
    return fitted(eye, corners, width / Math.max(1, this.canvas.clientHeight));
  }

  /** Return where in the grid the surface is seen at a place of the view in CSS px, and its height; null beside it. */
  pick(x: number, y: number): [number, number, number] | null {
    const camera = this.camera();
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    const at = (depth: number): Vector3 =>
      new Vector3((2 * x) / width - 1, 1 - (2 * y) / height, depth).unproject(camera);
    return pickHeight(this.surface, this.facts.range, this.toGrid(at(-1)), this.toGrid(at(1)));
  }

  /** Return a PNG of what is seen, on an opaque ground. */
  async picture(ground: string): Promise<Blob> {
    this.job++;
    this.renderPasses(this.fineStride());
    return opaquePicture(this.canvas, ground, (pen) => this.drawOver(pen));
  }

  dispose(): void {
    this.disposed = true;
    this.job++;
    cancelAnimationFrame(this.frame);
    window.clearTimeout(this.still);
    this.sizeWatch.disconnect();
    for (const target of this.targets) target.dispose();
    this.parts.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  private rebuild(): void {
    this.parts.dispose();
    this.parts = makeSurfaceScene(this.surface, this.grey, this.middle);
    this.drawnInk = "";
    this.redraw();
  }

  private camera(turnDeg = 0): Camera {
    const aspect = this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight);
    const camera = cameraOf(this.settings().eye, aspect, turnDeg);
    if (this.colouring().by !== "micrograph") {
      const { clientWidth, clientHeight } = this.canvas;
      camera.setViewOffset(clientWidth, clientHeight, COLOUR_BAR_PX / 2, 0, clientWidth, clientHeight);
    }
    return camera;
  }

  private lift(): number {
    return this.parts.scale * this.settings().exaggeration;
  }

  private toGrid(point: Vector3): Vector3 {
    const { rows, cols, pixelSize } = this.surface;
    const cell = pixelSize * this.parts.scale;
    return new Vector3(point.x / cell + (cols - 1) / 2, (rows - 1) / 2 - point.y / cell, point.z / this.lift() + this.middle);
  }

  private toScene(x: number, y: number, height: number, out: Vector3): Vector3 {
    const { rows, cols, pixelSize } = this.surface;
    const cell = pixelSize * this.parts.scale;
    return out.set((x - (cols - 1) / 2) * cell, ((rows - 1) / 2 - y) * cell, (height - this.middle) * this.lift());
  }

  private fit(): boolean {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth, clientHeight } = this.canvas;
    if (!clientWidth || !clientHeight) return false;
    const size = this.renderer.getSize(new Vector2());
    if (size.x !== clientWidth || size.y !== clientHeight || this.renderer.getPixelRatio() !== ratio) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(clientWidth, clientHeight, false);
    }
    return true;
  }

  private drawMoving(): void {
    if (!this.fit()) return;
    const triangles = this.renderPasses(this.movingStride());
    this.annotate();
    this.onPicture("moving", triangles);
    const job = this.job;
    void this.finished().then(() => {
      // What is drawn now is on the screen when the next frame begins.
      requestAnimationFrame(() => this.drawn());
      if (job !== this.job) return;
      if (this.fineStride() < this.movingStride()) {
        this.still = window.setTimeout(() => void this.drawStill(++this.job), STILL_AFTER_MS);
      } else this.onPicture("still", triangles);
    });
  }

  /** Draw at full resolution, a slice for each frame, and show the picture when it is complete. */
  private async drawStill(job: number): Promise<void> {
    const stride = this.fineStride();
    let triangles = 0;
    const passes = this.passes();
    let perSlice = 24;
    for (const [index, camera] of passes.entries()) {
      const target = this.target(index, 4);
      const tiles = this.tiles(stride, camera);
      this.renderer.setRenderTarget(target);
      this.renderer.clear();
      for (let done = 0; done < tiles.length; ) {
        const start = performance.now();
        const slice = tiles.slice(done, done + 2 * perSlice);
        this.renderSurface(slice, stride, camera, target);
        done += slice.length;
        await this.finished();
        if (job !== this.job) return;
        const spent = performance.now() - start;
        perSlice = Math.round(Math.min(512, Math.max(8, perSlice * Math.min(2, Math.max(0.5, SLICE_MS / spent)))));
      }
      this.renderExtras(camera, target);
      triangles += tiles.length * PATCH * PATCH;
    }
    this.show(passes.length);
    this.onPicture("still", triangles);
  }

  /** Wait until the graphics card has drawn all that it was told: or slices would queue up before what comes next. */
  private async finished(): Promise<void> {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    do await new Promise((resolve) => requestAnimationFrame(resolve));
    while (fence && !this.disposed && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED);
    gl.deleteSync(fence);
  }

  /** Render all passes at once and show them; returns the number of triangles (or dots). */
  private renderPasses(stride: number): number {
    let drawn = 0;
    const passes = this.passes();
    for (const [index, camera] of passes.entries()) {
      const target = this.target(index, 4);
      this.renderer.setRenderTarget(target);
      this.renderer.clear();
      const tiles = this.tiles(stride, camera);
      this.renderSurface(tiles, stride, camera, target);
      this.renderExtras(camera, target);
      drawn += tiles.length * PATCH * PATCH;
    }
    this.show(passes.length);
    return drawn;
  }

  private passes(): Camera[] {
    return this.settings().anaglyph ? [this.camera(-EYE_TURN_DEG), this.camera(EYE_TURN_DEG)] : [this.camera()];
  }

  private target(index: number, samples: number): WebGLRenderTarget {
    const size = this.renderer.getDrawingBufferSize(new Vector2());
    const made = (this.targets[index] ??= new WebGLRenderTarget(size.x, size.y, { samples }));
    made.setSize(size.x, size.y);
    return made;
  }

  private renderSurface(tiles: Float32Array, stride: number, camera: Camera, target: WebGLRenderTarget): void {
    const settings = this.settings();
    const colouring = this.colouring();
    const uniforms = this.parts.material.uniforms;
    const dots = settings.style === "points";
    uniforms.stride.value = stride;
    uniforms.lift.value = this.lift();
    uniforms.exaggeration.value = settings.exaggeration;
    uniforms.colourBy.value = this.grey || colouring.by !== "micrograph" ? KIND_NUMBER[colouring.by] : 0;
    uniforms.range.value.set(colouring.low, colouring.high);
    const azimuth = (settings.lightAzimuthDeg * Math.PI) / 180;
    const altitude = (settings.lightAltitudeDeg * Math.PI) / 180;
    uniforms.light.value.set(
      Math.sin(azimuth) * Math.cos(altitude), Math.cos(azimuth) * Math.cos(altitude), Math.sin(altitude),
    );
    uniforms.toEye.value.copy(directionOf(settings.eye));
    uniforms.shading.value = settings.shaded ? (colouring.by === "height" ? 1 : 0.6) : 0;
    uniforms.pointSize.value = dots ? Math.max(1.5, Math.min(7, 0.75 * stride * this.cellPx())) : 0;
    uniforms.wire.value = settings.style === "wireframe" ? wireStride(this.cellPx()) : 0;
    this.setTable(colouring.table);
    const patch = dots ? this.parts.points : this.parts.patch;
    setTiles(patch, tiles);
    this.scene.clear();
    this.scene.add(dots ? this.parts.dots : this.parts.surface);
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.scene, camera);
  }

  private setTable(table: Uint8Array): void {
    const texture = this.parts.material.uniforms.table.value;
    const data = texture.image.data as Uint8Array;
    let changed = false;
    for (let i = 0; i < 256; i++) {
      for (let channel = 0; channel < 3; channel++) {
        if (data[4 * i + channel] !== table[3 * i + channel]) changed = true;
        data[4 * i + channel] = table[3 * i + channel];
      }
      data[4 * i + 3] = 255;
    }
    if (changed) texture.needsUpdate = true;
  }

  private renderExtras(camera: Camera, target: WebGLRenderTarget): void {
    const settings = this.settings();
    if (!settings.cameras && !settings.sparse) return;
    const ink = this.ink();
    const key = `${ink.text} ${ink.accent} ${this.lift()}`;
    if (key !== this.drawnInk) {
      this.drawnInk = key;
      this.frames = cameraFrames(this.surface, ink.quiet, ink.accent);
      const points = new Float32Array(this.surface.points.length);
      const at = new Vector3();
      for (let k = 0; k < points.length; k += 3) {
        this.toScene(...gridFromWorld(this.surface, this.surface.points.subarray(k, k + 3)), at).toArray(points, k);
      }
      this.sparse = sparsePoints(points, ink.second);
    }
    this.scene.clear();
    if (settings.cameras && this.frames) this.scene.add(this.frames);
    if (settings.sparse && this.sparse) this.scene.add(this.sparse);
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.scene, camera);
  }

  private show(passes: number): void {
    const uniforms = this.screenMaterial.uniforms;
    uniforms.left.value = this.targets[0].texture;
    uniforms.right.value = this.targets[passes - 1].texture;
    uniforms.anaglyph.value = passes - 1;
    this.renderer.setRenderTarget(null);
    this.renderer.clear();
    this.scene.clear();
    this.scene.add(this.screen);
    this.renderer.render(this.scene, this.camera());
  }

  /** Side of a cell on the screen in px of the device, at the target. */
  private cellPx(): number {
    const height = this.renderer.getDrawingBufferSize(new Vector2()).y;
    return (this.surface.pixelSize * this.parts.scale * height) / (2 * this.settings().eye.reach);
  }

  private movingStride(): number {
    return movingStride(this.surface, this.settings(), this.cellPx());
  }

  private fineStride(): number {
    return fineStride(this.settings(), this.cellPx());
  }

  /** Return the tiles, x y x y, of a stride that a camera may see. */
  private tiles(stride: number, camera: Camera): Float32Array {
    return tilesSeen(this.surface, this.facts.range, PATCH * stride, camera, (x, y, z, out) => this.toScene(x, y, z, out));
  }

  private drawOver(pen: Pen2D): void {
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    const settings = this.settings();
    const ink = this.ink();
    const sign = unitSign(this.surface.unit);
    const camera = this.camera();
    const at = new Vector3();
    const onScreen = (point: Vector3): [number, number] | null => {
      point.project(camera);
      return Math.abs(point.z) <= 1 ? [((point.x + 1) / 2) * width, ((1 - point.y) / 2) * height] : null;
    };
    const project: Project = (x, y, z) => (Number.isNaN(z) ? null : onScreen(this.toScene(x, y, z, at)));
    if (settings.axes) drawAxes(pen, ink, this.surface, this.facts.shown, project, settings.eye.azimuthDeg, width);
    if (settings.cameras) {
      pen.textAlign = "center";
      pen.textBaseline = "bottom";
      for (const view of this.surface.cameras) {
        const place = onScreen(cameraPlace(view.rotation));
        if (place) {
          pen.fillStyle = view.reference ? ink.accent : ink.quiet;
          pen.fillText(`${view.tiltDeg >= 0 ? "" : "−"}${Math.abs(view.tiltDeg).toFixed(1)}°`, place[0], place[1] - 6);
        }
      }
    }
    this.marks(pen, project);
    const pxPerUnit = (this.parts.scale * height) / (2 * settings.eye.reach);
    drawScaleBar(pen, ink, pxPerUnit, sign, height, settings.eye.projection === "perspective" ? " at the centre" : "");
    drawColourBar(pen, ink, this.colouring(), width, height);
    pen.textAlign = "left";
    pen.textBaseline = "top";
    pen.fillStyle = ink.quiet;
    pen.fillText(`z × ${short(settings.exaggeration)}${settings.anaglyph ? " · red-cyan glasses" : ""}`, 18, 16);
  }
}
