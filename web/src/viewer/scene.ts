/** Textures and patches of a surface, for the graphics card: 16 to 20 bytes a height, and no mesh in memory. */

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DataTexture,
  DataUtils,
  FloatType,
  GLSL3,
  Group,
  HalfFloatType,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  LinearFilter,
  LinearMipmapLinearFilter,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  NearestFilter,
  Points,
  PointsMaterial,
  RawShaderMaterial,
  RedFormat,
  RGBAFormat,
  RGFormat,
  Sphere,
  Vector2,
  Vector3,
  type Texture,
} from "three";
import { slopeAt, triangleMask, withoutGaps } from "./grid";
import { SURFACE_FRAGMENT, SURFACE_VERTEX } from "./shaders";
import type { Space } from "./space";
import type { Surface } from "./types";

/** Cells along the side of a patch. */
export const PATCH = 64;
const LEAST_CAMERA_DISTANCE = 0.56;
/** Half the width of a camera's frame, where there is room for it. */
const FRAME = 0.04;

/** The parts of a surface that the 3D view draws. */
export interface SurfaceScene {
  material: RawShaderMaterial;
  patch: InstancedBufferGeometry;
  points: InstancedBufferGeometry;
  surface: Mesh;
  dots: Points;
  dispose(): void;
}

export function makeSurfaceScene(surface: Surface, grey: Uint8Array | null, space: Space): SurfaceScene {
  const { rows, cols } = surface;
  const { scale, middle } = space;
  const textures: Record<string, Texture> = {
    heights: plane(withoutGaps(surface), cols, rows, "float"),
    known: plane(surface.sigmaCode, cols, rows, "byte"),
    triangles: plane(triangleMask(surface), Math.max(1, cols - 1), Math.max(1, rows - 1), "byte"),
    slopes: slopeTexture(surface),
    micrograph: grey ? smoothGrey(grey, cols, rows) : plane(new Uint8Array([160]), 1, 1, "byte"),
    planes: pairTexture(surface),
    table: plane(new Uint8Array(256 * 4), 256, 1, "colour"),
  };
  const material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: SURFACE_VERTEX,
    fragmentShader: SURFACE_FRAGMENT,
    side: 2,
    uniforms: {
      ...Object.fromEntries(Object.entries(textures).map(([name, value]) => [name, { value }])),
      size: { value: new Vector2(cols, rows) },
      stride: { value: 1 },
      spacing: { value: new Vector2(surface.pixelSize * scale, -surface.pixelSize * scale) },
      middle: { value: middle },
      lift: { value: scale },
      pointSize: { value: 0 },
      colourBy: { value: 1 },
      range: { value: new Vector2(0, 1) },
      light: { value: new Vector3(0, 0, 1) },
      shading: { value: 1 },
      exaggeration: { value: 1 },
      toEye: { value: new Vector3(0, 0, 1) },
      wire: { value: 0 },
    },
  });
  const mostTiles = Math.ceil(rows / PATCH) * Math.ceil(cols / PATCH);
  const patch = patchGeometry(true, mostTiles);
  const points = patchGeometry(false, mostTiles);
  const mesh = new Mesh(patch, material);
  const dots = new Points(points, material);
  for (const drawn of [mesh, dots]) drawn.frustumCulled = false;
  return {
    material,
    patch,
    points,
    surface: mesh,
    dots,
    dispose() {
      for (const thing of [...Object.values(textures), material, patch, points]) thing.dispose();
    },
  };
}

/** Put the tiles, x y x y, that the next picture shall draw into a patch. */
export function setTiles(patch: InstancedBufferGeometry, tiles: Float32Array): void {
  const attribute = patch.getAttribute("tile") as InstancedBufferAttribute;
  (attribute.array as Float32Array).set(tiles);
  attribute.clearUpdateRanges();
  attribute.addUpdateRange(0, tiles.length);
  attribute.needsUpdate = true;
  patch.instanceCount = tiles.length / 2;
}

function patchGeometry(filled: boolean, mostTiles: number): InstancedBufferGeometry {
  const geometry = new InstancedBufferGeometry();
  // Vertices on the far sides belong to the next patch: dots there would be drawn twice.
  const side = filled ? PATCH + 1 : PATCH;
  const position = new Float32Array(2 * side * side);
  for (let i = 0; i < side * side; i++) position.set([i % side, Math.floor(i / side)], 2 * i);
  geometry.setAttribute("position", new BufferAttribute(position, 2));
  geometry.setAttribute("tile", new InstancedBufferAttribute(new Float32Array(2 * mostTiles), 2));
  geometry.boundingSphere = new Sphere(new Vector3(), 2);
  if (filled) {
    const index = new Uint16Array(6 * PATCH * PATCH);
    for (let row = 0, k = 0; row < PATCH; row++) {
      for (let col = 0; col < PATCH; col++, k += 6) {
        const a = row * side + col;
        // Cut from upper right to lower left, as the run's mesh is; the last corner of each tells the shader its cell.
        index.set([a + side, a + 1, a, a + 1, a + side, a + side + 1], k);
      }
    }
    geometry.setIndex(new BufferAttribute(index, 1));
  }
  return geometry;
}

function plane(data: Float32Array | Uint8Array, width: number, height: number, kind: "float" | "byte" | "colour"): DataTexture {
  const texture = new DataTexture(data as BufferSource as never, width, height, kind === "colour" ? RGBAFormat : RedFormat);
  if (kind === "float") texture.type = FloatType;
  texture.internalFormat = { float: "R32F", byte: "R8", colour: "RGBA8" }[kind] as never;
  texture.minFilter = texture.magFilter = kind === "colour" ? LinearFilter : NearestFilter;
  texture.unpackAlignment = 1;
  texture.needsUpdate = true;
  return texture;
}

/** Code of the uncertainty and number of views, side by side. */
function pairTexture(surface: Surface): DataTexture {
  const pairs = new Uint8Array(2 * surface.sigmaCode.length);
  for (let i = 0; i < surface.sigmaCode.length; i++) {
    pairs[2 * i] = surface.sigmaCode[i];
    pairs[2 * i + 1] = surface.nViews[i];
  }
  const texture = new DataTexture(pairs, surface.cols, surface.rows, RGFormat);
  texture.internalFormat = "RG8";
  texture.unpackAlignment = 1;
  texture.needsUpdate = true;
  return texture;
}

function slopeTexture(surface: Surface): DataTexture {
  const { rows, cols } = surface;
  const slopes = new Uint16Array(2 * rows * cols);
  const here = new Float32Array(2);
  for (let row = 0, k = 0; row < rows; row++) {
    for (let col = 0; col < cols; col++, k += 2) {
      slopeAt(surface, row, col, here);
      slopes[k] = DataUtils.toHalfFloat(Math.min(1000, Math.max(-1000, here[0])));
      slopes[k + 1] = DataUtils.toHalfFloat(Math.min(1000, Math.max(-1000, here[1])));
    }
  }
  const texture = new DataTexture(slopes, cols, rows, RGFormat, HalfFloatType);
  texture.internalFormat = "RG16F";
  return smooth(texture);
}

function smoothGrey(grey: Uint8Array, cols: number, rows: number): DataTexture {
  const texture = new DataTexture(grey as never, cols, rows, RedFormat);
  texture.internalFormat = "R8";
  return smooth(texture);
}

function smooth(texture: DataTexture): DataTexture {
  texture.magFilter = LinearFilter;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.generateMipmaps = true;
  texture.anisotropy = 4;
  texture.unpackAlignment = 1;
  texture.needsUpdate = true;
  return texture;
}

/**
 * Return how far from the middle the cameras are drawn, in the scene's lengths: over the surface, whose highest place is
 * at `top`, and apart from each other. Their rays are parallel, so that only their direction means something.
 */
export function cameraDistance(surface: Surface, top: number): number {
  return Math.max(LEAST_CAMERA_DISTANCE, top + 0.2, Math.min(1, (2.5 * FRAME) / leastAngle(surface)));
}

function leastAngle(surface: Surface): number {
  const directions = surface.cameras.map((camera) => cameraPlace(camera.rotation, 1));
  return Math.min(Math.PI / 2, ...directions.flatMap((one, i) => directions.slice(i + 1).map((other) => one.angleTo(other))).filter(Boolean));
}

/** Return the series' cameras as small picture frames that look at the middle, in the scene's lengths. */
export function cameraFrames(surface: Surface, distance: number, colour: string, accent: string): Group {
  const group = new Group();
  const frame = Math.min(FRAME, 0.4 * leastAngle(surface) * distance);
  for (const camera of surface.cameras) {
    const [x, y, z] = [0, 3, 6].map((row) => new Vector3(...(camera.rotation.slice(row, row + 3) as [number, number, number])));
    const eye = cameraPlace(camera.rotation, distance);
    const corner = (i: number, j: number): Vector3 =>
      eye.clone().addScaledVector(x, frame * i).addScaledVector(y, frame * j).addScaledVector(z, 1.25 * frame);
    const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    const lines = corners.flatMap((place, i) => [place, corners[(i + 1) % 4], place, eye]);
    lines.push(eye, eye.clone().addScaledVector(z, distance - 0.06));
    const material = new LineBasicMaterial({ color: new Color(camera.reference ? accent : colour), transparent: true, opacity: 0.9 });
    group.add(new LineSegments(new BufferGeometry().setFromPoints(lines), material));
  }
  return group;
}

/** Return where the viewer draws a camera. */
export function cameraPlace(rotation: number[], distance: number): Vector3 {
  return new Vector3(rotation[6], rotation[7], rotation[8]).multiplyScalar(-distance);
}

/** Return the sparse points, in the scene's lengths without exaggeration. */
export function sparsePoints(xyz: Float32Array, colour: string): Points {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(xyz, 3));
  const material = new PointsMaterial({ color: new Color(colour), size: 2, sizeAttenuation: false });
  const points = new Points(geometry, material);
  points.frustumCulled = false;
  return points;
}
