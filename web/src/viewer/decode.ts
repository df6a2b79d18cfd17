/** The surface container of docs/viewer.md: a JSON header, then one compressed plane after another. */

import type { LengthUnit, Surface } from "./types";

const MAGIC = "SEMSURF1";

interface PlanePlace {
  offset: number;
  length: number;
}

interface Header {
  name: string;
  rows: number;
  cols: number;
  length_unit: LengthUnit;
  pixel_size: number;
  world_from_grid: number[];
  stride: number;
  full_shape: [number, number];
  height_origin: number;
  height_step: number;
  height_bytes: number;
  sigma_origin: number;
  sigma_ratio: number;
  reasons?: Record<number, string>;
  height_scale_relative_sigma: number | null;
  cameras: {
    name: string;
    tilt_deg: number;
    tilt_sigma_deg: number | null;
    rotation: number[];
    reference: boolean;
  }[];
  points_origin: number[];
  points_step: number[];
  planes: Record<string, PlanePlace>;
}

/** Return the surface that the bytes hold; rejects with a sentence where they hold none. */
export async function decodeSurface(bytes: ArrayBuffer): Promise<Surface> {
  const view = new DataView(bytes);
  const magic = bytes.byteLength > 12 ? new TextDecoder().decode(new Uint8Array(bytes, 0, 8)) : "";
  if (magic !== MAGIC) throw new Error("this is no surface of semscape, or one of a newer version");
  const headerLength = view.getUint32(8, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 12, headerLength))) as Header;
  const start = 12 + headerLength;
  const plane = (name: string): Uint8Array | null => {
    const place = header.planes[name];
    return place ? new Uint8Array(bytes, start + place.offset, place.length) : null;
  };
  const inflated = async (name: string): Promise<Uint8Array> => {
    const packed = plane(name);
    return packed ? inflate(packed) : new Uint8Array(0);
  };
  const [heightBytes, sigmaBytes, viewBytes, pointBytes, reasonBytes] = await Promise.all(
    ["height", "sigma", "n_views", "points", "reason"].map(inflated),
  );
  const { rows, cols } = header;
  const sigmaCode = undelta(sigmaBytes, cols);
  const image = plane("micrograph");
  return {
    name: header.name,
    rows,
    cols,
    unit: header.length_unit,
    pixelSize: header.pixel_size,
    worldFromGrid: header.world_from_grid,
    height: decodeHeights(heightBytes, sigmaCode, header),
    heightStep: header.height_step,
    sigmaCode,
    sigmaOfCode: Float32Array.from({ length: 256 }, (_, code) =>
      code < 2 ? NaN : header.sigma_origin * header.sigma_ratio ** (code - 2),
    ),
    nViews: undelta(viewBytes, cols),
    reason: reasonBytes.length ? undelta(reasonBytes, cols) : null,
    reasonNames: header.reasons ?? {},
    micrograph: image ? new Blob([image as BlobPart], { type: "image/jpeg" }) : null,
    heightScaleRelativeSigma: header.height_scale_relative_sigma,
    cameras: header.cameras.map((camera) => ({
      name: camera.name,
      tiltDeg: camera.tilt_deg,
      tiltSigmaDeg: camera.tilt_sigma_deg,
      rotation: camera.rotation,
      reference: camera.reference,
    })),
    points: decodePoints(pointBytes, header),
    stride: header.stride,
    fullShape: header.full_shape,
  };
}

async function inflate(packed: Uint8Array): Promise<Uint8Array> {
  const stream = new Blob([packed as BlobPart]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Undo differences to the left neighbour, whose row's first is to the one above; bytes wrap around. */
function undelta(bytes: Uint8Array, cols: number): Uint8Array {
  for (let start = 0; start < bytes.length; start += cols) {
    if (start) bytes[start] += bytes[start - cols];
    for (let i = start + 1; i < start + cols; i++) bytes[i] += bytes[i - 1];
  }
  return bytes;
}

/** Undo byte planes, zigzag and the prediction left + above - above left. */
function decodeHeights(bytes: Uint8Array, sigmaCode: Uint8Array, header: Header): Float32Array {
  const { rows, cols } = header;
  const size = rows * cols;
  const heights = new Float32Array(size);
  let above = new Int32Array(cols + 1);
  let current = new Int32Array(cols + 1);
  for (let row = 0, i = 0; row < rows; row++) {
    let left = 0;
    let aboveLeft = 0;
    for (let col = 0; col < cols; col++, i++) {
      let code = bytes[i];
      for (let b = 1; b < header.height_bytes; b++) code |= bytes[b * size + i] << (8 * b);
      const residual = (code >>> 1) ^ -(code & 1);
      const value = (residual + left + above[col] - aboveLeft) | 0;
      aboveLeft = above[col];
      left = value;
      current[col] = value;
      heights[i] = sigmaCode[i] ? header.height_origin + value * header.height_step : NaN;
    }
    [above, current] = [current, above];
  }
  return heights;
}

function decodePoints(bytes: Uint8Array, header: Header): Float32Array {
  const count = Math.floor(bytes.length / 6);
  const codes = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const points = new Float32Array(3 * count);
  for (let k = 0; k < 3 * count; k++) {
    points[k] = header.points_origin[k % 3] + codes.getUint16(2 * k, true) * header.points_step[k % 3];
  }
  return points;
}
