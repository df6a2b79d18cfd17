/** Pointer, wheel and keys over the two views. */

import type { Eye } from "./camera";
import type { Map2D } from "./map2d";
import type { Viewer } from "./mount";
import type { Place } from "./measure";
import type { View3D } from "./view3d";

const CLICK_PX = 4;
const HANDLE_PX = 11;
const TURN_DEG_PER_PX = 0.35;

export interface EyeMoves {
  turned(eye: Eye, azimuthDeg: number, elevationDeg: number): Eye;
  moved(eye: Eye, right: number, up: number): Eye;
  zoomed(eye: Eye, factor: number, x?: number, y?: number, aspect?: number): Eye;
  /** The eye of the start, as near as the surface allows. */
  home(eye: Eye): Eye;
}

/** A wheel scrolls the page, unless the view has been clicked or Ctrl is held. */
function wheelIsMeant(canvas: HTMLCanvasElement, event: WheelEvent): boolean {
  return event.ctrlKey || event.metaKey || document.activeElement === canvas;
}

function wheelFactor(event: WheelEvent): number {
  const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
  return Math.exp(Math.min(1, Math.max(-1, event.deltaY * lines * 0.0016)));
}

/** Take a place for the tool: one more, or the first of a new measurement where it has all. */
function mark(viewer: Viewer, place: Place): void {
  const { asks } = viewer.tool();
  if (!asks) return;
  const places = viewer.places();
  viewer.setPlaces(places.length < asks ? [...places, place] : [place]);
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
    const found = view.pick(now.x, now.y);
    if (!found) return;
    viewer.setCursor({ x: found[0], y: found[1] });
    mark(viewer, viewer.cursor()!);
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => {
    if (!pointers.size) viewer.setCursor(null);
  });
  canvas.addEventListener(
    "wheel",
    (event) => {
      if (!wheelIsMeant(canvas, event)) return;
      event.preventDefault();
      const { x, y } = here(event);
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      setEye(eyes.zoomed(viewer.settings().eye, wheelFactor(event), (2 * x) / width - 1, 1 - (2 * y) / height, width / height));
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const { eye } = viewer.settings();
    const [right, up] = arrow(event);
    if (right || up) setEye(event.shiftKey ? eyes.moved(eye, 0.08 * right, 0.08 * up) : eyes.turned(eye, 5 * right, 5 * up));
    else if (event.key === "+" || event.key === "=") setEye(eyes.zoomed(eye, 1 / 1.15));
    else if (event.key === "-") setEye(eyes.zoomed(eye, 1.15));
    else if (event.key === "0" || event.key === "Home") setEye(eyes.home(eye));
    else return;
    event.preventDefault();
  });
}

export function watchMap(map: Map2D, viewer: Viewer): void {
  const { canvas } = map;
  let dragged: number | null = null;
  let before: { x: number; y: number } | null = null;
  let start = { x: 0, y: 0 };
  let opened = false;
  const here = (event: PointerEvent | WheelEvent): { x: number; y: number } => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const inside = (x: number, y: number): boolean =>
    x >= -0.5 && y >= -0.5 && x <= viewer.surface.cols - 0.5 && y <= viewer.surface.rows - 0.5;
  const handleAt = (x: number, y: number): number => {
    const sizes = viewer.places().map((place) => {
      const [left, top] = map.toScreen(place.x, place.y);
      return Math.hypot(left - x, top - y);
    });
    const nearest = sizes.indexOf(Math.min(...sizes));
    return sizes[nearest] <= HANDLE_PX ? nearest : -1;
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    const now = (start = here(event));
    opened = false;
    dragged = null;
    before = null;
    const [x, y] = map.toGrid(now.x, now.y);
    if (event.button !== 0 || !viewer.tool().asks) {
      before = now;
      return;
    }
    const handle = handleAt(now.x, now.y);
    if (handle >= 0) dragged = handle;
    else if (inside(x, y)) {
      viewer.setCursor({ x, y });
      mark(viewer, viewer.cursor()!);
      opened = true;
    }
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = here(event);
    const [x, y] = map.toGrid(now.x, now.y);
    if (before && event.buttons) {
      map.moveBy(now.x - before.x, now.y - before.y);
      before = now;
      return;
    }
    viewer.setCursor(inside(x, y) || dragged !== null ? { x, y } : null);
    const place = viewer.cursor();
    if (!event.buttons || !place) return;
    const places = viewer.places();
    // A press that goes on as a drag marks the next place where it ends.
    if (opened && places.length < viewer.tool().asks && Math.hypot(now.x - start.x, now.y - start.y) > CLICK_PX) {
      viewer.setPlaces([...places, place]);
      dragged = places.length;
      opened = false;
    } else if (dragged !== null) {
      viewer.setPlaces(places.map((old, i) => (i === dragged ? place : old)));
    }
  });
  const lift = (): void => {
    before = null;
    dragged = null;
    opened = false;
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => viewer.setCursor(null));
  canvas.addEventListener(
    "wheel",
    (event) => {
      if (!wheelIsMeant(canvas, event)) return;
      event.preventDefault();
      const { x, y } = here(event);
      map.zoomBy(1 / wheelFactor(event), x, y);
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const [right, up] = arrow(event);
    const { rows, cols } = viewer.surface;
    const place = viewer.cursor() ?? { x: Math.floor((cols - 1) / 2), y: Math.floor((rows - 1) / 2) };
    if (right || up) {
      const step = event.shiftKey ? 10 : 1;
      const next = { x: place.x + step * right, y: place.y - step * up };
      viewer.setCursor(viewer.cursor() ? next : place, true);
      const cursor = viewer.cursor()!;
      map.reveal(cursor.x, cursor.y);
    } else if (event.key === "Enter" || event.key === " ") {
      viewer.setCursor(place, true);
      mark(viewer, viewer.cursor()!);
    } else if (event.key === "Backspace") viewer.setPlaces(viewer.places().slice(0, -1));
    else if (event.key === "Escape") viewer.setPlaces([]);
    else if (event.key === "+" || event.key === "=") map.zoomBy(1.3, ...map.toScreen(place.x, place.y));
    else if (event.key === "-") map.zoomBy(1 / 1.3);
    else if (event.key === "0") map.fit();
    else return;
    event.preventDefault();
  });
}

function arrow(event: KeyboardEvent): [number, number] {
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
