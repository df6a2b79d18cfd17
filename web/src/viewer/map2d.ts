/** The height map seen from straight above, in the colours of the 3D view. It needs no graphics card. */

import { opaquePicture } from "./picture";
import { COLOUR_BAR_PX, drawColourBar, drawScaleBar, isFitted, penOf, type Ink, type Pen2D } from "./annotate";
import type { Colouring } from "./colours";
import { slopeAt, type Heights } from "./grid";
import { unitSign } from "./numbers";
import type { Settings } from "./settings";
import type { Surface } from "./types";

const MOST_ZOOM_PX = 48;
const MARGIN_PX = 12;

/** A surface at half, a quarter, ... of its resolution, so that a small picture of it does not flicker. */
type Level = Heights & Pick<Surface, "sigmaCode" | "nViews"> & { grey: Uint8Array | null };

export class Map2D {
  readonly canvas = document.createElement("canvas");
  readonly overlay = document.createElement("canvas");
  /** Draws cursor and marks over the map. */
  marks: (pen: Pen2D) => void = () => undefined;

  private readonly levels: Level[];
  private readonly image = document.createElement("canvas");
  private frame = 0;
  private zoom = 1;
  /** Place of the grid in the middle of the view. */
  private middle: [number, number];
  private readonly sizeWatch: ResizeObserver;

  constructor(
    private readonly surface: Surface,
    grey: Uint8Array | null,
    private readonly settings: () => Settings,
    private readonly colouring: () => Colouring,
    private readonly ink: () => Ink,
  ) {
    this.canvas.className = "sv-canvas";
    this.overlay.className = "sv-overlay";
    this.levels = [{ ...surface, grey }];
    this.middle = [(surface.cols - 1) / 2, (surface.rows - 1) / 2];
    this.sizeWatch = new ResizeObserver(() => isFitted(this.canvas) || this.redraw());
    this.sizeWatch.observe(this.canvas);
  }

  redraw(): void {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.draw();
      this.annotate();
    });
  }

  annotate(): void {
    const pen = penOf(this.overlay);
    if (pen) this.drawOver(pen);
  }

  /** Width for the map itself, beside the colour bar. */
  private viewWidth(): number {
    return this.canvas.clientWidth - (this.colouring().by === "micrograph" ? 0 : COLOUR_BAR_PX);
  }

  /** CSS px per grid step. */
  scale(): number {
    const { rows, cols } = this.surface;
    const width = Math.max(1, this.viewWidth() - 2 * MARGIN_PX);
    const height = Math.max(1, this.canvas.clientHeight - 2 * MARGIN_PX);
    return Math.min(width / cols, height / rows) * this.zoom;
  }

  toScreen(x: number, y: number): [number, number] {
    const scale = this.scale();
    return [
      this.viewWidth() / 2 + (x - this.middle[0]) * scale,
      this.canvas.clientHeight / 2 + (y - this.middle[1]) * scale,
    ];
  }

  toGrid(x: number, y: number): [number, number] {
    const scale = this.scale();
    return [
      this.middle[0] + (x - this.viewWidth() / 2) / scale,
      this.middle[1] + (y - this.canvas.clientHeight / 2) / scale,
    ];
  }

  moveBy(dx: number, dy: number): void {
    const scale = this.scale();
    this.setMiddle(this.middle[0] - dx / scale, this.middle[1] - dy / scale);
  }

  /** Zoom such that what is at a place of the view stays there; without one, at the middle. */
  zoomBy(factor: number, x = this.viewWidth() / 2, y = this.canvas.clientHeight / 2): void {
    const [gridX, gridY] = this.toGrid(x, y);
    this.zoom = Math.min(Math.max(1, this.zoom * factor), Math.max(1, (MOST_ZOOM_PX * this.zoom) / this.scale()));
    const scale = this.scale();
    this.setMiddle(
      gridX - (x - this.viewWidth() / 2) / scale, gridY - (y - this.canvas.clientHeight / 2) / scale,
    );
  }

  fit(): void {
    this.zoom = 1;
    this.setMiddle(0, 0);
  }

  /** Bring a place of the grid into view. */
  reveal(x: number, y: number): void {
    const [left, top] = this.toScreen(x, y);
    const inside = left >= 0 && top >= 0 && left <= this.viewWidth() && top <= this.canvas.clientHeight;
    if (!inside) this.setMiddle(x, y);
  }

  /** Return a PNG of the map with its bars on an opaque ground. */
  async picture(ground: string): Promise<Blob> {
    this.draw();
    return opaquePicture(this.canvas, ground, (pen) => this.drawOver(pen));
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.sizeWatch.disconnect();
  }

  private setMiddle(x: number, y: number): void {
    const { rows, cols } = this.surface;
    // Zoomed out it is centred; zoomed in its edges stay at the view's edges.
    const bound = (value: number, size: number, view: number): number => {
      const half = view / 2 / this.scale();
      return size <= 2 * half ? (size - 1) / 2 : Math.min(size - 0.5 - half + 8 / this.scale(), Math.max(half - 0.5 - 8 / this.scale(), value));
    };
    this.middle = [bound(x, cols, this.viewWidth()), bound(y, rows, this.canvas.clientHeight)];
    this.redraw();
  }

  private draw(): void {
    const pen = penOf(this.canvas);
    if (!pen) return;
    const ratio = window.devicePixelRatio || 1;
    const [left, top] = this.toScreen(-0.5, -0.5);
    const [right, bottom] = this.toScreen(this.surface.cols - 0.5, this.surface.rows - 0.5);
    const x0 = Math.max(0, Math.floor(left * ratio));
    const y0 = Math.max(0, Math.floor(top * ratio));
    const width = Math.min(this.canvas.width, Math.ceil(right * ratio)) - x0;
    const height = Math.min(this.canvas.height, Math.ceil(bottom * ratio)) - y0;
    if (width < 1 || height < 1) return;
    const number = Math.max(0, Math.floor(Math.log2(1 / (this.scale() * ratio)) + 0.35));
    const picture = this.rendered(this.level(number), 2 ** number, x0, y0, width, height, ratio);
    this.image.width = width;
    this.image.height = height;
    this.image.getContext("2d")!.putImageData(picture, 0, 0);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.drawImage(this.image, x0, y0);
  }

  private rendered(
    level: Level, shrink: number, x0: number, y0: number, width: number, height: number, ratio: number,
  ): ImageData {
    const picture = new ImageData(width, height);
    const pixels = picture.data;
    const settings = this.settings();
    const colouring = this.colouring();
    const { table, low, high } = colouring;
    const azimuth = (settings.lightAzimuthDeg * Math.PI) / 180;
    const altitude = (settings.lightAltitudeDeg * Math.PI) / 180;
    const light = [Math.sin(azimuth) * Math.cos(altitude), Math.cos(azimuth) * Math.cos(altitude), Math.sin(altitude)];
    const shading = settings.shaded && colouring.by !== "micrograph" ? (colouring.by === "height" ? 0.85 : 0.5) : 0;
    const slope = [0, 0];
    const columns = Int32Array.from({ length: width }, (_, i) => {
      const [x] = this.toGrid((x0 + i + 0.5) / ratio, 0);
      return Math.min(level.cols - 1, Math.max(0, Math.floor((x + 0.5) / shrink)));
    });
    for (let j = 0, at = 0; j < height; j++) {
      const [, y] = this.toGrid(0, (y0 + j + 0.5) / ratio);
      const row = Math.min(level.rows - 1, Math.max(0, Math.floor((y + 0.5) / shrink)));
      for (let i = 0; i < width; i++, at += 4) {
        const k = row * level.cols + columns[i];
        const z = level.height[k];
        if (z !== z) continue;
        let factor = 1;
        if (shading) {
          slopeAt(level, row, columns[i], slope);
          const p = slope[0] * settings.exaggeration;
          const q = slope[1] * settings.exaggeration;
          const cosine = Math.max(0, (-p * light[0] - q * light[1] + light[2]) / Math.sqrt(1 + p * p + q * q));
          factor = 1 + shading * (0.42 + 0.82 * cosine - 1);
        }
        if (colouring.by === "micrograph") {
          pixels[at] = pixels[at + 1] = pixels[at + 2] = level.grey ? level.grey[k] : 160;
        } else {
          const shown = colouring.by === "height" ? z : colouring.by === "sigma" ? level.sigmaCode[k] : level.nViews[k];
          const t = Math.min(1, Math.max(0, (shown - low) / (high - low)));
          const colour = 3 * Math.round(255 * t);
          pixels[at] = table[colour] * factor;
          pixels[at + 1] = table[colour + 1] * factor;
          pixels[at + 2] = table[colour + 2] * factor;
        }
        pixels[at + 3] = 255;
      }
    }
    return picture;
  }

  private level(number: number): Level {
    while (this.levels.length <= number) this.levels.push(halved(this.levels[this.levels.length - 1]));
    return this.levels[number];
  }

  private drawOver(pen: Pen2D): void {
    const ink = this.ink();
    const { clientWidth, clientHeight } = this.canvas;
    this.marks(pen);
    drawScaleBar(pen, ink, this.scale() / this.surface.pixelSize, unitSign(this.surface.unit), clientHeight, "");
    drawColourBar(pen, ink, this.colouring(), clientWidth, clientHeight);
  }
}

/** Return means of 2 x 2 heights, unknown where more than half of them are; of codes one of the four. */
function halved(level: Level): Level {
  const rows = Math.ceil(level.rows / 2);
  const cols = Math.ceil(level.cols / 2);
  const small: Level = {
    rows,
    cols,
    pixelSize: 2 * level.pixelSize,
    height: new Float32Array(rows * cols),
    sigmaCode: new Uint8Array(rows * cols),
    nViews: new Uint8Array(rows * cols),
    grey: level.grey && new Uint8Array(rows * cols),
  };
  for (let row = 0, k = 0; row < rows; row++) {
    const below = Math.min(2 * row + 1, level.rows - 1) * level.cols;
    for (let col = 0; col < cols; col++, k++) {
      const right = Math.min(2 * col + 1, level.cols - 1);
      const four = [2 * row * level.cols + 2 * col, 2 * row * level.cols + right, below + 2 * col, below + right];
      let n = 0;
      let sum = 0;
      let grey = 0;
      for (const i of four) {
        if (level.grey) grey += level.grey[i];
        const z = level.height[i];
        if (z !== z) continue;
        n++;
        sum += z;
        small.sigmaCode[k] = level.sigmaCode[i];
        small.nViews[k] = level.nViews[i];
      }
      small.height[k] = n >= 2 ? sum / n : NaN;
      if (small.grey) small.grey[k] = grey / 4;
    }
  }
  return small;
}
