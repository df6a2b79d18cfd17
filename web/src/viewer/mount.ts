/** Put the viewer together: two views of one surface, the tools, and what they share. */

import { inkOf, type Ink } from "./annotate";
import { HOME, moved, TOP, turned, zoomed } from "./camera";
import type { Colouring } from "./colours";
import { el, freshId, save } from "./dom";
import { drawCursor, drawMarks } from "./draw_marks";
import { watchView } from "./interaction";
import { Map2D } from "./map2d";
import { watchMap } from "./map_interaction";
import { cancelled, canClose, closed, NO_MARKS, openPlaces, restoredMarks, withPlace, type Marks, type Shape } from "./marks";
import { cursorText, surfaceText } from "./readout";
import { showResults } from "./results";
import { colouringOf, factsOf, restored, type Settings } from "./settings";
import { installStyle } from "./style";
import { icon, segments, toolbar } from "./toolbar";
import { finding, hintOf, TOOLS, toolOf, type Choices, type Tool } from "./tools";
import type { Place, Surface, Theme, ViewerHandle, ViewerOptions, ViewerState } from "./types";
import { View3D } from "./view3d";

const STATE_AFTER_MS = 300;

/** What the views, tools and their watchers share. */
export interface Viewer {
  surface: Surface;
  settings(): Settings;
  change(changes: Partial<Settings>): void;
  tool(): Tool;
  shape(): Shape;
  marks(): Marks;
  setMarks(marks: Marks): void;
  /** Take a place for the tool. */
  mark(place: Place): void;
  cursor(): Place | null;
  /** Move the cursor to the nearest height; spoken where it was moved by keyboard. */
  setCursor(place: Place | null, spoken?: boolean): void;
}

/** Show a surface in an element, which should have a height. */
export function mountViewer(element: HTMLElement, surface: Surface, options: ViewerOptions = {}): ViewerHandle {
  installStyle();
  const facts = factsOf(surface);
  let settings = restored(options.state?.settings);
  let theme: Theme = options.theme ?? "auto";
  let tool = toolOf(String(options.state?.tool ?? "inspect"));
  let marks = restoredMarks(options.state?.marks, tool, surface);
  const choices: Choices = { nestingIndex: 0, reference: "rim", shape: "rectangle", ...(options.state?.choices as Partial<Choices>) };
  let cursor: Place | null = null;
  let colouring: Colouring = colouringOf(settings, surface, facts);
  let ink: Ink | null = null;
  let stateTimer = 0;
  let view: View3D | null = null;
  let map: Map2D | null = null;
  let disposed = false;

  const readout = el("p", { class: "sv-readout" });
  const spoken = el("p", { class: "sv-spoken", role: "status" });
  const hint = el("p", { class: "sv-hint" });
  const results = el("div", { class: "sv-results", hidden: true });
  const view3dPane = el("div", { class: "sv-pane sv-pane-3d" });
  const mapPane = el("div", { class: "sv-pane" });
  const toolButtons = TOOLS.map((each) => {
    const button = el("button", { type: "button", "data-tool": each.name }, icon(each.icon), each.title);
    button.addEventListener("click", () => takeTool(each));
    return button;
  });
  const shapes = segments<Shape>(
    "Shape of a region", [["rectangle", "Rectangle"], ["polygon", "Polygon"]], () => choices.shape,
    (shape) => {
      // What was begun as the other shape is none of this one.
      if (shape !== choices.shape && openPlaces(marks).length) marks = cancelled(marks);
      choices.shape = shape;
      measureAnew();
      keepState();
    },
  );
  const close = el("button", { type: "button", class: "sv-button" }, "Close polygon");
  close.addEventListener("click", () => viewer.setMarks(closed(marks)));
  const clear = el("button", { type: "button", class: "sv-button" }, "Clear");
  clear.addEventListener("click", () => viewer.setMarks(NO_MARKS));
  const tools = el(
    "div", { class: "sv-tools" },
    el("div", { class: "sv-segments", role: "group", "aria-label": "Tools" }, ...toolButtons),
    shapes.group,
    close,
    clear,
    hint,
  );
  const root = el(
    "div", { class: "sv-root", role: "region", "aria-label": options.label ?? "Surface", "data-theme": theme },
    el("div", { class: "sv-views" }, view3dPane, mapPane),
    readout, spoken, tools, results,
  );

  const viewer: Viewer = {
    surface,
    settings: () => settings,
    change(changes) {
      settings = { ...settings, ...changes };
      colouring = colouringOf(settings, surface, facts);
      view?.redraw();
      if (!onlyEye(changes)) {
        map?.redraw();
        refresh?.();
      } else if (changes.eye) refresh?.();
      keepState();
    },
    tool: () => tool,
    shape: () => choices.shape,
    marks: () => marks,
    setMarks(changed) {
      marks = changed;
      measureAnew();
      keepState();
    },
    mark(place) {
      viewer.setMarks(withPlace(tool, choices.shape, marks, place));
    },
    cursor: () => cursor,
    setCursor(place, aloud = false) {
      cursor = place && { x: clamp(Math.round(place.x), surface.cols), y: clamp(Math.round(place.y), surface.rows) };
      tellCursor(aloud);
      annotate();
    },
  };

  function takeTool(next: Tool): void {
    if (next.name !== tool.name) marks = NO_MARKS;
    tool = next;
    measureAnew();
    keepState();
  }

  function measureAnew(): void {
    const found = finding(tool, surface, marks, choices);
    showResults(results, tool, surface, marks.places, found, {
      choices: () => choices,
      choose(changes) {
        Object.assign(choices, changes);
        measureAnew();
        keepState();
      },
      point: (place) => viewer.setCursor(place),
    });
    for (const [i, button] of toolButtons.entries()) button.setAttribute("aria-pressed", String(TOOLS[i] === tool));
    hint.textContent = hintOf(tool, choices.shape, marks);
    shapes.group.hidden = !tool.regions;
    shapes.refresh();
    close.hidden = !canClose(tool, choices.shape, marks);
    clear.hidden = !marks.places.length;
    annotate();
  }

  function annotate(): void {
    view?.annotate();
    map?.annotate();
  }

  function tellCursor(aloud: boolean): void {
    const text = cursor ? cursorText(surface, cursor) : [];
    readout.replaceChildren(...text.map(([name, value]) => el("span", {}, el("b", {}, name), ` ${value}`)));
    if (!cursor) readout.textContent = surfaceText(surface, facts.known);
    if (aloud && cursor) spoken.textContent = text.map(([name, value]) => `${name} ${value}`).join(", ");
  }

  function keepState(): void {
    if (!options.onState) return;
    window.clearTimeout(stateTimer);
    stateTimer = window.setTimeout(() => options.onState?.(state()), STATE_AFTER_MS);
  }

  function state(): ViewerState {
    return { settings, tool: tool.name, marks, choices: { ...choices } };
  }

  const currentInk = (): Ink => (ink ??= inkOf(root));
  const repaint = (): void => {
    ink = null;
    view?.redraw();
    map?.redraw();
  };
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", repaint);

  function setTheme(next: Theme): void {
    theme = next;
    root.dataset.theme = next;
    root.dispatchEvent(new CustomEvent("semscape-theme", { bubbles: true, detail: next }));
    repaint();
  }

  async function picture(): Promise<Blob> {
    const ground = getComputedStyle(root).getPropertyValue("--sv-pane").trim();
    return view ? view.picture(ground) : map!.picture(ground);
  }

  let refresh: (() => void) | null = null;
  element.append(root);

  const firstPicture = (async (): Promise<void> => {
    const grey = await greyOf(surface);
    if (disposed) return;
    map = new Map2D(surface, grey, () => settings, () => colouring, currentInk);
    map.canvas.dataset.name = "map";
    describe(map.canvas, "Height map from above", "Arrow keys move the cursor, with Shift by ten; Enter marks a place, Enter again there closes a polygon, Backspace takes the last place back, Escape cancels; plus and minus zoom, 0 fits.");
    mapPane.append(map.canvas, map.overlay, cornerButtons([["+", "Zoom in", () => map?.zoomBy(1.5)], ["−", "Zoom out", () => map?.zoomBy(1 / 1.5)]]));
    map.marks = (pen) => {
      const find = (x: number, y: number): [number, number] => map!.toScreen(x, y);
      drawMarks(pen, currentInk(), tool, choices.shape, marks, cursor, find, false);
      if (cursor) drawCursor(pen, currentInk(), find(cursor.x, cursor.y));
    };
    watchMap(map, viewer);
    let firstIn3D: Promise<void> = Promise.resolve();
    if (facts.known || surface.points.length) {
      try {
        view = new View3D(surface, facts, grey, { settings: () => settings, colouring: () => colouring, ink: currentInk });
        firstIn3D = view.firstPicture;
      } catch (error) {
        const why = error instanceof Error && error.message.startsWith("the graphics card") ? `${error.message}.` :
          "The 3D view needs WebGL 2, which this browser does not offer: switch on hardware acceleration, or open the page in another browser. Map and tools work without it.";
        view3dPane.append(el("p", { class: "sv-message", role: "status" }, why));
      }
    } else view3dPane.append(el("p", { class: "sv-message", role: "status" }, "No height is known."));
    const made = toolbar(
      {
        settings: () => settings,
        change: (changes) => viewer.change(changes),
        look: (where) =>
          viewer.change({ eye: view!.fitted({ ...{ home: HOME, top: TOP, here: settings.eye }[where], projection: settings.eye.projection }) }),
        savePicture: () => void picture().then((blob) => save(blob, "surface.png")),
        theme: () => theme,
        setTheme,
      },
      {
        micrograph: grey !== null,
        sigma: facts.hasSigma,
        views: facts.mostViews > 0,
        cameras: surface.cameras.length > 0,
        sparse: surface.points.length > 0,
        view3d: view !== null,
      },
      options.exports ?? [],
    );
    root.prepend(made.bar);
    refresh = made.refresh;
    if (view) {
      const shown = view;
      shown.canvas.dataset.name = "surface";
      describe(shown.canvas, "Surface in three dimensions", "Arrow keys turn the view, with Shift they move it; plus and minus zoom, 0 goes back to the start.");
      view3dPane.append(shown.canvas, shown.overlay, cornerButtons([
        ["+", "Zoom in", () => viewer.change({ eye: zoomed(settings.eye, 1 / 1.3) })],
        ["−", "Zoom out", () => viewer.change({ eye: zoomed(settings.eye, 1.3) })],
      ]));
      shown.marks = (pen, project) => {
        const find = (x: number, y: number): [number, number] | null => {
          const i = clamp(Math.round(y), surface.rows) * surface.cols + clamp(Math.round(x), surface.cols);
          return project(x, y, surface.height[i]);
        };
        drawMarks(pen, currentInk(), tool, choices.shape, marks, cursor, find, true);
        const at = cursor && find(cursor.x, cursor.y);
        if (at) drawCursor(pen, currentInk(), at);
      };
      shown.onPicture = (kind, triangles) => {
        root.dataset.picture = kind;
        root.dataset.triangles = String(triangles);
        root.dataset.pictures = String(Number(root.dataset.pictures ?? 0) + 1);
      };
      watchView(shown, viewer, { turned, moved, zoomed, home: (eye) => shown.fitted({ ...HOME, projection: eye.projection }) });
      const kept = options.state?.settings as { eye?: unknown } | undefined;
      if (!kept?.eye) viewer.change({ eye: shown.fitted(HOME) });
    }
    tellCursor(false);
    measureAnew();
    map.redraw();
    view?.redraw();
    await firstIn3D;
    root.dataset.ready = "true";
  })();

  return {
    root,
    firstPicture,
    setTheme,
    state,
    picture,
    dispose() {
      disposed = true;
      window.clearTimeout(stateTimer);
      dark.removeEventListener("change", repaint);
      view?.dispose();
      map?.dispose();
      root.remove();
    },
  };
}

function onlyEye(changes: Partial<Settings>): boolean {
  return Object.keys(changes).every((key) => key === "eye");
}

function clamp(value: number, size: number): number {
  return Math.min(size - 1, Math.max(0, value));
}

function describe(canvas: HTMLCanvasElement, name: string, keys: string): void {
  const id = freshId("keys");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", name);
  canvas.setAttribute("aria-describedby", id);
  canvas.append(el("span", { id }, keys));
  canvas.title = keys;
}

function cornerButtons(items: [string, string, () => void][]): HTMLElement {
  return el(
    "div", { class: "sv-corner" },
    ...items.map(([text, name, act]) => {
      const button = el("button", { type: "button", "aria-label": name, title: name }, text);
      button.addEventListener("click", act);
      return button;
    }),
  );
}

/** Return the micrograph's grey levels over the grid; null where there is none, or the browser cannot read it. */
async function greyOf(surface: Surface): Promise<Uint8Array | null> {
  if (!surface.micrograph) return null;
  try {
    const bitmap = await createImageBitmap(surface.micrograph);
    const canvas = el("canvas", { width: surface.cols, height: surface.rows });
    const pen = canvas.getContext("2d", { willReadFrequently: true })!;
    pen.drawImage(bitmap, 0, 0);
    bitmap.close();
    const pixels = pen.getImageData(0, 0, surface.cols, surface.rows).data;
    const grey = new Uint8Array(surface.rows * surface.cols);
    for (let i = 0; i < grey.length; i++) grey[i] = pixels[4 * i];
    return grey;
  } catch {
    return null;
  }
}
