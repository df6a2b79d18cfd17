/** Letters and lines over the surface in three dimensions: axes, the cameras' tilts, marks, bars, what z is stretched by. */

import { drawColourBar, drawScaleBar, type Pen2D } from "./annotate";
import { drawAxes } from "./axes";
import { short, unitSign } from "./numbers";
import type { Camera, Look } from "./painter";
import { cameraPlace } from "./scene";
import type { Facts } from "./settings";
import type { Surface } from "./types";

/** A place of the surface in the view, in CSS px; null where it is behind the eye or unknown. */
export type Project = (x: number, y: number, height: number) => [number, number] | null;

export interface Sight {
  width: number;
  height: number;
  /** Length of the scene per unit of length of the surface. */
  scale: number;
  camera: Camera;
  project: Project;
  marks: (pen: Pen2D, project: Project) => void;
}

export function drawOver3D(pen: Pen2D, look: Look, surface: Surface, facts: Facts, sight: Sight): void {
  const { width, height, project } = sight;
  const settings = look.settings();
  const ink = look.ink();
  if (settings.axes) drawAxes(pen, ink, surface, facts.shown, project, settings.eye.azimuthDeg, [width, height]);
  if (settings.cameras) {
    pen.textAlign = "center";
    pen.textBaseline = "bottom";
    for (const view of surface.cameras) {
      const place = cameraPlace(view.rotation).project(sight.camera);
      if (Math.abs(place.z) > 1) continue;
      const tilt = `${view.tiltDeg >= 0 ? "" : "−"}${Math.abs(view.tiltDeg).toFixed(1)}°`;
      pen.fillStyle = view.reference ? ink.accent : ink.quiet;
      pen.fillText(tilt, ((place.x + 1) / 2) * width, ((1 - place.y) / 2) * height - 6);
    }
  }
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
