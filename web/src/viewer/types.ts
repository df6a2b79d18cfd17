/** A place in the grid in px: x right, y down, the centre of the first height at 0, 0. */
export interface Place {
  x: number;
  y: number;
}

/** A camera of the series: parallel projection along the rows of `rotation`, camera from world. */
export interface SurfaceCamera {
  name: string;
  tiltDeg: number;
  tiltSigmaDeg: number | null;
  /** 3 x 3, row by row; the last row is the direction of view in the world. */
  rotation: number[];
  reference: boolean;
}

export type LengthUnit = "um" | "px";

/** A height map with all that the viewer shows of it. Arrays are row by row; the first row has the largest y. */
export interface Surface {
  name: string;
  rows: number;
  cols: number;
  unit: LengthUnit;
  /** Distance of neighbouring heights. */
  pixelSize: number;
  /** 4 x 4, row by row: world = worldFromGrid (col, row, height, 1). */
  worldFromGrid: number[];
  /** In `unit`; NaN is unknown. */
  height: Float32Array;
  /** Heights are multiples of this above the lowest; 0 where they are exact. */
  heightStep: number;
  /** Code of the 1-sigma uncertainty; `sigmaOfCode` gives its value. 0: no height, 1: height without uncertainty. */
  sigmaCode: Uint8Array;
  /** (256,) 1-sigma in `unit` of each code, NaN for 0 and 1. */
  sigmaOfCode: Float32Array;
  /** Views that agree on each height. */
  nViews: Uint8Array;
  /** Why each height is unknown, 0 where it is known; null where nothing tells. */
  reason: Uint8Array | null;
  /** What the codes of `reason` mean. */
  reasonNames: Record<number, string>;
  /** The reference micrograph on the surface, as a JPEG, or null. */
  micrograph: Blob | null;
  /** Relative sigma that all heights share, null where it is unknown. */
  heightScaleRelativeSigma: number | null;
  cameras: SurfaceCamera[];
  /** Sparse points, x y z in the world, or empty. */
  points: Float32Array;
  /** Every n-th row and column of the run's map is here. */
  stride: number;
  /** Rows and columns of the run's map. */
  fullShape: [number, number];
}

/** A file the page can offer; the viewer only lists it. */
export interface ExportLink {
  label: string;
  href: string;
  /** Name under which the browser saves it. */
  download?: string;
}

export type Theme = "auto" | "light" | "dark";

export interface ViewerOptions {
  /** Files of other formats, which the page (or the server behind it) has. */
  exports?: ExportLink[];
  theme?: Theme;
  /** What an earlier handle's `state()` returned. */
  state?: ViewerState;
  /** Called after each change that `state()` would tell, at most every 300 ms. */
  onState?: (state: ViewerState) => void;
  /** Heading of the viewer for screen readers. */
  label?: string;
}

/** All that a user has set: plain JSON, to be kept over a reload. */
export type ViewerState = Record<string, unknown>;

export interface ViewerHandle {
  /** The root element of the viewer, inside the element it was mounted in. */
  readonly root: HTMLElement;
  /** Resolves when the first picture is on the screen. */
  readonly firstPicture: Promise<void>;
  setTheme(theme: Theme): void;
  state(): ViewerState;
  /** PNG of the 3D view with its bars, or of the 2D map where there is no WebGL. */
  picture(): Promise<Blob>;
  dispose(): void;
}
