/** What is drawn over a view with lines and letters: colour bar, scale bar, marks of the tools. */

import type { Colouring } from "./colours";
import { roundLength, short } from "./numbers";

export interface Ink {
  text: string;
  quiet: string;
  line: string;
  /** Behind letters that stand on a picture. */
  halo: string;
  accent: string;
  second: string;
}

export const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif';

/** Return the colours of a theme, from the style sheet of the viewer. */
export function inkOf(root: HTMLElement): Ink {
  const style = getComputedStyle(root);
  const colour = (name: string): string => style.getPropertyValue(name).trim();
  return {
    text: colour("--sv-ink"),
    quiet: colour("--sv-quiet"),
    line: colour("--sv-line"),
    halo: colour("--sv-halo"),
    accent: colour("--sv-accent"),
    second: colour("--sv-second"),
  };
}

function pixelsOf(canvas: HTMLCanvasElement): [number, number] {
  const ratio = window.devicePixelRatio || 1;
  return [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
}

/** Whether a canvas has the size of its place on the screen. */
export function isFitted(canvas: HTMLCanvasElement): boolean {
  const [width, height] = pixelsOf(canvas);
  return canvas.width === width && canvas.height === height;
}

/** Fit a canvas to its place on the screen and return its pen, in CSS px; null where it has no size. */
export function penOf(canvas: HTMLCanvasElement): CanvasRenderingContext2D | null {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = pixelsOf(canvas);
  if (!width || !height) return null;
  if (!isFitted(canvas)) {
    canvas.width = width;
    canvas.height = height;
  }
  const pen = canvas.getContext("2d");
  if (!pen) return null;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  pen.font = FONT;
  return pen;
}

export function label(pen: CanvasRenderingContext2D, ink: Ink, text: string, x: number, y: number, colour = ink.text): void {
  pen.lineJoin = "round";
  pen.lineWidth = 3.5;
  pen.strokeStyle = ink.halo;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

/** Width that a view leaves for the colour bar. */
export const COLOUR_BAR_PX = 88;

/** Draw a vertical colour bar against the right edge; its height follows the view's. */
export function drawColourBar(pen: CanvasRenderingContext2D, ink: Ink, colouring: Colouring, width: number, height: number): void {
  if (colouring.by === "micrograph" || height < 150) return;
  // Above the buttons in the corner.
  const length = Math.min(240, height - 140);
  const top = Math.max(40, (height - length) / 2 - 20);
  const thick = 12;
  const x = width - 18 - thick;
  for (let row = 0; row < length; row++) {
    const i = 3 * Math.round(255 * (1 - row / (length - 1)));
    pen.fillStyle = `rgb(${colouring.table[i]} ${colouring.table[i + 1]} ${colouring.table[i + 2]})`;
    pen.fillRect(x, top + row, thick, 1.5);
  }
  pen.strokeStyle = ink.halo;
  pen.lineWidth = 1;
  pen.strokeRect(x - 0.5, top - 0.5, thick + 1, length + 1.5);
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const mark of colouring.marks) {
    const y = top + length * (1 - (mark.at - colouring.low) / (colouring.high - colouring.low));
    label(pen, ink, mark.text, x - 7, y);
    pen.fillStyle = ink.text;
    pen.fillRect(x - 4, y - 0.5, 4, 1);
  }
  pen.textBaseline = "alphabetic";
  label(pen, ink, colouring.title, x + thick, top - 12);
}

/** Draw a bar of a round length at the lower left. */
export function drawScaleBar(
  pen: CanvasRenderingContext2D, ink: Ink, pxPerUnit: number, sign: string, height: number, note: string,
): void {
  if (!(pxPerUnit > 0) || !Number.isFinite(pxPerUnit)) return;
  const length = roundLength(130 / pxPerUnit);
  const width = length * pxPerUnit;
  const [x, y] = [18, height - 20];
  pen.fillStyle = ink.halo;
  pen.fillRect(x - 2, y - 2, width + 4, 8);
  pen.fillStyle = ink.text;
  pen.fillRect(x, y, width, 4);
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  label(pen, ink, `${short(length)} ${sign}${note}`, x, y - 8);
}

export type Pen2D = CanvasRenderingContext2D;

/** Draw a line with a halo through places of the view; a null breaks it. */
export function drawPath(pen: Pen2D, ink: Ink, places: ([number, number] | null)[], colour: string, width = 2): void {
  pen.lineJoin = pen.lineCap = "round";
  for (const [stroke, thick] of [[ink.halo, width + 2.5], [colour, width]] as const) {
    pen.strokeStyle = stroke;
    pen.lineWidth = thick;
    pen.beginPath();
    let open = false;
    for (const place of places) {
      if (!place) open = false;
      else if (open) pen.lineTo(...place);
      else {
        pen.moveTo(...place);
        open = true;
      }
    }
    pen.stroke();
  }
}

/** Draw a small disc with a letter beside it. */
export function drawDot(pen: Pen2D, ink: Ink, [x, y]: [number, number], colour: string, text: string): void {
  pen.beginPath();
  pen.arc(x, y, 4.5, 0, 2 * Math.PI);
  pen.fillStyle = colour;
  pen.fill();
  pen.lineWidth = 1.75;
  pen.strokeStyle = ink.halo;
  pen.stroke();
  if (!text) return;
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  label(pen, ink, text, x + 8, y - 8);
}
