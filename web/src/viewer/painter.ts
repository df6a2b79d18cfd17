/** Draws the surface with the graphics card: into targets off the screen, one for each eye, and these on the screen. */

import {
  ColorManagement,
  GLSL3,
  LinearSRGBColorSpace,
  Mesh,
  PlaneGeometry,
  RawShaderMaterial,
  Scene,
  Vector2,
  WebGLRenderer,
  WebGLRenderTarget,
  type Group,
  type OrthographicCamera,
  type PerspectiveCamera,
  type Points,
} from "three";
import type { Ink } from "./annotate";
import { directionOf } from "./camera";
import type { Colouring } from "./colours";
import { fineStride, movingStride, tilesSeen, wireStride } from "./detail";
import { gridFromWorld } from "./grid";
import { cameraDistance, cameraFrames, makeSurfaceScene, PATCH, setTiles, sparsePoints, type SurfaceScene } from "./scene";
import type { Facts, Settings } from "./settings";
import { SCREEN_FRAGMENT, SCREEN_VERTEX } from "./shaders";
import type { Space } from "./space";
import type { Surface } from "./types";

const SMOOTH_SAMPLES = 4;
const KIND_NUMBER = { micrograph: 0, height: 1, sigma: 2, views: 3 } as const;

export type Camera = PerspectiveCamera | OrthographicCamera;

/** How the surface shall look now. */
export interface Look {
  settings(): Settings;
  colouring(): Colouring;
  ink(): Ink;
}

export class Painter {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly screen: Mesh;
  private readonly screenMaterial: RawShaderMaterial;
  /** By eye and number of samples. */
  private readonly targets = new Map<string, WebGLRenderTarget>();
  private parts: SurfaceScene;
  private frames: Group | null = null;
  private sparse: Points | null = null;
  private drawnInk = "";
  private disposed = false;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly surface: Surface,
    private readonly facts: Facts,
    private readonly grey: Uint8Array | null,
    private readonly space: Space,
    private readonly look: Look,
  ) {
    ColorManagement.enabled = false;
    this.renderer = new WebGLRenderer({ canvas, alpha: true, antialias: false, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.renderer.setClearColor(0x000000, 0);
    const largest = this.renderer.capabilities.maxTextureSize;
    if (Math.max(surface.rows, surface.cols) > largest) {
      this.renderer.dispose();
      throw new Error(`the graphics card takes ${largest} heights a side, the surface has more; the map beside shows all of them`);
    }
    this.parts = makeSurfaceScene(surface, grey, space);
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
  }

  /** Fit the picture to the canvas' place on the page; false where it has none. */
  fit(): boolean {
    if (!this.canvas.clientWidth || !this.canvas.clientHeight) return false;
    if (!this.isFitted()) {
      this.renderer.setPixelRatio(pixelRatio());
      this.renderer.setSize(this.canvas.clientWidth, this.canvas.clientHeight, false);
    }
    return true;
  }

  /** Whether the picture has the size of its place. */
  isFitted(): boolean {
    const size = this.renderer.getSize(new Vector2());
    const { clientWidth, clientHeight } = this.canvas;
    return size.x === clientWidth && size.y === clientHeight && this.renderer.getPixelRatio() === pixelRatio();
  }

  /** Every n-th row and column is drawn while something moves. */
  movingStride(): number {
    return movingStride(this.surface, this.look.settings(), this.cellPx());
  }

  /** Every n-th row and column is drawn when all is still. */
  fineStride(): number {
    return fineStride(this.look.settings(), this.cellPx());
  }

  /** Return the tiles, x y x y, of a stride that a camera may see. */
  tiles(stride: number, camera: Camera): Float32Array {
    return tilesSeen(this.surface, this.facts.range, PATCH * stride, camera, (x, y, z, out) => this.space.toScene(x, y, z, out));
  }

  /** Render all passes at once and show them, smoothed or not; returns the number of triangles (or dots). */
  paint(passes: Camera[], stride: number, smooth: boolean): number {
    let drawn = 0;
    for (const [index, camera] of passes.entries()) {
      this.begin(index, smooth);
      drawn += this.surfaceTiles(this.tiles(stride, camera), stride, camera);
      this.extras(camera);
    }
    this.show(passes, smooth);
    return drawn;
  }

  /** Start a pass into its target. */
  begin(index: number, smooth: boolean): void {
    this.renderer.setRenderTarget(this.target(index, smooth));
    this.renderer.clear();
  }

  /** Draw tiles of the surface into the target; returns the number of triangles (or dots). */
  surfaceTiles(tiles: Float32Array, stride: number, camera: Camera): number {
    const settings = this.look.settings();
    const colouring = this.look.colouring();
    const uniforms = this.parts.material.uniforms;
    const dots = settings.style === "points";
    uniforms.stride.value = stride;
    uniforms.lift.value = this.space.lift();
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
    setTiles(dots ? this.parts.points : this.parts.patch, tiles);
    this.scene.clear();
    this.scene.add(dots ? this.parts.dots : this.parts.surface);
    this.renderer.render(this.scene, camera);
    return tiles.length * PATCH * PATCH;
  }

  /** Draw the series' cameras and sparse points into the target, where they are shown. */
  extras(camera: Camera): void {
    const settings = this.look.settings();
    if (!settings.cameras && !settings.sparse) return;
    const ink = this.look.ink();
    const key = `${ink.text} ${ink.accent} ${this.space.lift()}`;
    if (key !== this.drawnInk) {
      this.drawnInk = key;
      this.frames = cameraFrames(this.surface, cameraDistance(this.surface, this.space.top()), ink.quiet, ink.accent);
      const points = new Float32Array(this.surface.points.length);
      for (let k = 0; k < points.length; k += 3) {
        this.space.toScene(...gridFromWorld(this.surface, this.surface.points.subarray(k, k + 3))).toArray(points, k);
      }
      this.sparse = sparsePoints(points, ink.second);
    }
    this.scene.clear();
    if (settings.cameras && this.frames) this.scene.add(this.frames);
    if (settings.sparse && this.sparse) this.scene.add(this.sparse);
    this.renderer.render(this.scene, camera);
  }

  /** Put the targets on the screen: one as it is, two as an anaglyph. */
  show(passes: Camera[], smooth: boolean): void {
    const uniforms = this.screenMaterial.uniforms;
    uniforms.left.value = this.target(0, smooth).texture;
    uniforms.right.value = this.target(passes.length - 1, smooth).texture;
    uniforms.anaglyph.value = passes.length - 1;
    this.renderer.setRenderTarget(null);
    this.renderer.clear();
    this.scene.clear();
    this.scene.add(this.screen);
    this.renderer.render(this.scene, passes[0]);
  }

  /** Wait until the graphics card has drawn all that it was told: or slices would queue up before what comes next. */
  async finished(): Promise<void> {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    do await new Promise((resolve) => requestAnimationFrame(resolve));
    while (fence && !this.disposed && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED);
    gl.deleteSync(fence);
  }

  /** Make anew what a lost context has taken. */
  rebuild(): void {
    this.parts.dispose();
    this.parts = makeSurfaceScene(this.surface, this.grey, this.space);
    this.drawnInk = "";
  }

  dispose(): void {
    this.disposed = true;
    for (const target of this.targets.values()) target.dispose();
    this.parts.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  private target(index: number, smooth: boolean): WebGLRenderTarget {
    const key = `${index} ${smooth}`;
    const size = this.renderer.getDrawingBufferSize(new Vector2());
    const made = this.targets.get(key) ?? new WebGLRenderTarget(size.x, size.y, { samples: smooth ? SMOOTH_SAMPLES : 0 });
    made.setSize(size.x, size.y);
    this.targets.set(key, made);
    return made;
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

  /** Side of a cell on the screen in px of the device, at the target of the eye. */
  private cellPx(): number {
    const height = this.renderer.getDrawingBufferSize(new Vector2()).y;
    return (this.surface.pixelSize * this.space.scale * height) / (2 * this.look.settings().eye.reach);
  }
}

function pixelRatio(): number {
  return Math.min(window.devicePixelRatio || 1, 2);
}
