export { decodeSurface } from "./decode";
export { triangleMask } from "./grid";
export { closedRings, NO_MARKS, type Marks } from "./marks";
export { mountViewer } from "./mount";
export type { ExportLink, Surface, SurfaceCamera, Theme, ViewerHandle, ViewerOptions, ViewerState } from "./types";
