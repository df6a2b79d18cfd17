export { decodeSurface } from "./decode";
export { mountViewer } from "./mount";
export type { ExportLink, Surface, SurfaceCamera, Theme, ViewerHandle, ViewerOptions, ViewerState } from "./types";
