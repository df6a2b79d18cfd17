/** Pointer, wheel and keys over the view in three dimensions, and what the map's watcher shares with it. */

import type { Eye } from "./camera";
import { canClose, cancelled, openPlaces, takenBack } from "./marks";
import type { Viewer } from "./mount";
import type { View3D } from "./view3d";

/** A pointer that travels less between press and lift has clicked. */
export const CLICK_PX = 4;
const HANDLE_PX = 11;
const TURN_DEG_PER_PX = 0.35;

export interface EyeMoves {
  turned(eye: Eye, azimuthDeg: number, elevationDeg: number): Eye;
  moved(eye: Eye, right: number, up: number): Eye;
  zoomed(eye: Eye, factor: number, x?: number, y?: number, aspect?: number): Eye;
  /** The eye of the start, as near as the surface allows. */
  home(eye: Eye): Eye;
}

/** Zoom by the wheel, which scrolls the page unless the view has been clicked or Ctrl is held. */
export function onWheel(canvas: HTMLCanvasElement, zoom: (factor: number, event: WheelEvent) => void): void {
  canvas.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== canvas) return;
      event.preventDefault();
      const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
      zoom(Math.exp(Math.min(1, Math.max(-1, event.deltaY * lines * 0.0016))), event);
    },
    { passive: false },
  );
}

/** Return the number of the mark that is at a place of a view in CSS px, -1 for none. */
export function handleAt(viewer: Viewer, x: number, y: number, toScreen: (x: number, y: number) => [number, number] | null): number {
  const sizes = viewer.marks().places.map((place) => {
    const at = toScreen(place.x, place.y);
    return at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
  });
  const nearest = sizes.indexOf(Math.min(...sizes));
  return sizes[nearest] <= HANDLE_PX ? nearest : -1;
}

/** Whether a mark is one that closes the polygon that is drawn: its first corner, or its last for a double click. */
export function closes(viewer: Viewer, index: number): boolean {
  const marks = viewer.marks();
  if (index < 0 || !canClose(viewer.tool(), viewer.shape(), marks)) return false;
  return index === marks.places.length - openPlaces(marks).length || index === marks.places.length - 1;
}

/** Do what a key asks of the marks; false where it asks nothing of them. */
export function markKey(viewer: Viewer, event: KeyboardEvent): boolean {
  if (!viewer.marks().places.length) return false;
  if (event.key === "Backspace") viewer.setMarks(takenBack(viewer.marks()));
  else if (event.key === "Escape") viewer.setMarks(cancelled(viewer.marks()));
  else return false;
  return true;
}

export function watchView(view: View3D, viewer: Viewer, eyes: EyeMoves): void {
  const { canvas } = view;
  const pointers = new Map<number, { x: number; y: number }>();
  let travelled = 0;
  const setEye = (eye: Eye): void => viewer.change({ eye });
  const here = (event: PointerEvent | WheelEvent): { x: number; y: number } => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, here(event));
    travelled = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = here(event);
    const before = pointers.get(event.pointerId);
    if (!before) {
      const found = view.pick(now.x, now.y);
      viewer.setCursor(found && { x: found[0], y: found[1] });
      return;
    }
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    travelled += Math.abs(dx) + Math.abs(dy);
    const half = canvas.clientHeight / 2;
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)![1];
      const size = (a: { x: number; y: number }, b: { x: number; y: number }): number => Math.hypot(a.x - b.x, a.y - b.y);
      const eye = eyes.moved(viewer.settings().eye, -dx / 2 / half, dy / 2 / half);
      setEye(eyes.zoomed(eye, size(before, other) / Math.max(1, size(now, other))));
    } else if (event.buttons & 6 || event.shiftKey) {
      setEye(eyes.moved(viewer.settings().eye, -dx / half, dy / half));
    } else {
      setEye(eyes.turned(viewer.settings().eye, -dx * TURN_DEG_PER_PX, dy * TURN_DEG_PER_PX));
    }
    pointers.set(event.pointerId, now);
  });
  const lift = (event: PointerEvent): void => {
    if (!pointers.delete(event.pointerId) || event.type !== "pointerup") return;
    if (travelled > CLICK_PX || event.button !== 0) return;
    const now = here(event);
    const handle = handleAt(viewer, now.x, now.y, (x, y) => view.toScreen(x, y));
    if (closes(viewer, handle)) return viewer.mark(viewer.marks().places[handle]);
    const found = view.pick(now.x, now.y);
    if (!found) return;
    viewer.setCursor({ x: found[0], y: found[1] });
    viewer.mark(viewer.cursor()!);
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => {
    if (!pointers.size) viewer.setCursor(null);
  });
  onWheel(canvas, (factor, event) => {
    const { x, y } = here(event);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    setEye(eyes.zoomed(viewer.settings().eye, factor, (2 * x) / width - 1, 1 - (2 * y) / height, width / height));
  });
  canvas.addEventListener("keydown", (event) => {
    const { eye } = viewer.settings();
    const [right, up] = arrow(event);
    if (right || up) setEye(event.shiftKey ? eyes.moved(eye, 0.08 * right, 0.08 * up) : eyes.turned(eye, 5 * right, 5 * up));
    else if (event.key === "+" || event.key === "=") setEye(eyes.zoomed(eye, 1 / 1.15));
    else if (event.key === "-") setEye(eyes.zoomed(eye, 1.15));
    else if (event.key === "0" || event.key === "Home") setEye(eyes.home(eye));
    else if (!markKey(viewer, event)) return;
    event.preventDefault();
  });
}

/** Return how far an arrow key goes to the right and up. */
export function arrow(event: KeyboardEvent): [number, number] {
  switch (event.key) {
    case "ArrowLeft":
      return [-1, 0];
    case "ArrowRight":
      return [1, 0];
    case "ArrowUp":
      return [0, 1];
    case "ArrowDown":
      return [0, -1];
    default:
      return [0, 0];
  }
}
