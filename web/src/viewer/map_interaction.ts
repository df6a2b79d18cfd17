/** Pointer, wheel and keys over the map. */

import { arrow, CLICK_PX, closes, handleAt, markKey, onWheel } from "./interaction";
import type { Map2D } from "./map2d";
import { openPlaces, withMoved } from "./marks";
import type { Viewer } from "./mount";

export function watchMap(map: Map2D, viewer: Viewer): void {
  const { canvas } = map;
  let dragged: number | null = null;
  let before: { x: number; y: number } | null = null;
  let start = { x: 0, y: 0 };
  /** A press that may go on as a drag, which then marks the next place where it ends. */
  let opened = false;
  /** A press on a corner that closes the polygon, unless it goes on as a drag of that corner. */
  let closing = false;
  const here = (event: PointerEvent | WheelEvent): { x: number; y: number } => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const inside = (x: number, y: number): boolean =>
    x >= -0.5 && y >= -0.5 && x <= viewer.surface.cols - 0.5 && y <= viewer.surface.rows - 0.5;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    const now = (start = here(event));
    opened = closing = false;
    dragged = null;
    before = null;
    const tool = viewer.tool();
    const [x, y] = map.toGrid(now.x, now.y);
    if (event.button !== 0 || !(tool.points || tool.regions)) {
      before = now;
      return;
    }
    const handle = handleAt(viewer, now.x, now.y, (col, row) => map.toScreen(col, row));
    if (handle >= 0) {
      dragged = handle;
      closing = closes(viewer, handle);
    } else if (inside(x, y)) {
      viewer.setCursor({ x, y });
      viewer.mark(viewer.cursor()!);
      const isPolygon = tool.regions > 0 && viewer.shape() === "polygon";
      opened = !isPolygon && openPlaces(viewer.marks()).length === 1;
      if (!opened) dragged = viewer.marks().places.length - 1;
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
    if (Math.hypot(now.x - start.x, now.y - start.y) <= CLICK_PX && (opened || closing)) return;
    closing = false;
    const marks = viewer.marks();
    if (opened) {
      viewer.mark(place);
      dragged = viewer.marks().places.length - 1;
      opened = false;
    } else if (dragged !== null) viewer.setMarks(withMoved(marks, dragged, place));
  });
  const lift = (event: PointerEvent): void => {
    if (closing && dragged !== null && event.type === "pointerup") viewer.mark(viewer.marks().places[dragged]);
    before = dragged = null;
    opened = closing = false;
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => viewer.setCursor(null));
  onWheel(canvas, (factor, event) => {
    const { x, y } = here(event);
    map.zoomBy(1 / factor, x, y);
  });
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
      viewer.mark(viewer.cursor()!);
    } else if (event.key === "+" || event.key === "=") map.zoomBy(1.3, ...map.toScreen(place.x, place.y));
    else if (event.key === "-") map.zoomBy(1 / 1.3);
    else if (event.key === "0") map.fit();
    else if (!markKey(viewer, event)) return;
    event.preventDefault();
  });
}
