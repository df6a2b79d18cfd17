import type { Surface, ViewerHandle, ViewerOptions, ViewerState } from "./types";

/** Show a surface in an element, which should have a height. */
export function mountViewer(element: HTMLElement, surface: Surface, options: ViewerOptions = {}): ViewerHandle {
  const root = document.createElement("section");
  root.className = "sv-root";
  root.textContent = `${surface.cols} x ${surface.rows} heights`;
  element.append(root);
  const state: ViewerState = { ...options.state };
  return {
    root,
    firstPicture: Promise.resolve(),
    setTheme: () => undefined,
    state: () => state,
    picture: () => Promise.reject(new Error("not yet")),
    dispose: () => root.remove(),
  };
}
