/** Letters and lines over the surface in three dimensions: axes, the cameras' tilts, marks, bars, what z is stretched by. */

import { drawColourBar, drawScaleBar, label, type Ink, type Pen2D } from "./annotate";
import { drawAxes } from "./axes";
import { fixed, short, unitSign } from "./numbers";
import type { Camera, Look } from "./painter";
import { cameraPlace } from "./scene";
import type { Facts } from "./settings";
import type { Surface } from "./types";

/** A place of the surface in the view, in CSS px; null where it is behind the eye or unknown. */
export type Project = (x: number, y: number, height: number) => [number, number] | null;

/** Room for the letters of a tilt. */
const LABEL_PX = [42, 15];

export interface Sight {
  width: number;
  height: number;
  /** Length of the scene per unit of length of the surface. */
  scale: number;
  camera: Camera;
  cameraDistance: number;
  project: Project;
  marks: (pen: Pen2D, project: Project) => void;
}

export function drawOver3D(pen: Pen2D, look: Look, surface: Surface, facts: Facts, sight: Sight): void {
  const { width, height, project } = sight;
  const settings = look.settings();
  const ink = look.ink();
  if (settings.axes) drawAxes(pen, ink, surface, facts.shown, project, settings.eye.azimuthDeg, [width, height]);
  if (settings.cameras) drawTilts(pen, ink, surface, sight);
  sight.marks(pen, project);
  const pxPerUnit = (sight.scale * height) / (2 * settings.eye.reach);
  const note = settings.eye.projection === "perspective" ? " at the centre" : "";
  drawScaleBar(pen, ink, pxPerUnit, unitSign(surface.unit), height, note);
  drawColourBar(pen, ink, look.colouring(), width, height);
  pen.textAlign = "left";
  pen.textBaseline = "top";
  pen.fillStyle = ink.quiet;
  pen.fillText(`z × ${short(settings.exaggeration)}${settings.anaglyph ? " · red-cyan glasses" : ""}`, 18, 16);
}

/** Write the tilts over the cameras, one over the other where they would cover each other. */
function drawTilts(pen: Pen2D, ink: Ink, surface: Surface, sight: Sight): void {
  pen.textAlign = "center";
  pen.textBaseline = "bottom";
  const taken: [number, number][] = [];
  for (const view of surface.cameras) {
    const place = cameraPlace(view.rotation, sight.cameraDistance).project(sight.camera);
    if (Math.abs(place.z) > 1) continue;
    const x = ((place.x + 1) / 2) * sight.width;
    let y = ((1 - place.y) / 2) * sight.height - 6;
    while (taken.some(([left, top]) => Math.abs(left - x) < LABEL_PX[0] && Math.abs(top - y) < LABEL_PX[1])) y -= LABEL_PX[1];
    taken.push([x, y]);
    label(pen, ink, `${fixed(view.tiltDeg, 1)}°`, x, y, view.reference ? ink.accent : ink.text);
  }
}
