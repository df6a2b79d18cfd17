/** The eye of the 3D view: where it looks from, as plain numbers, and the three.js camera for it. */

import { OrthographicCamera, PerspectiveCamera, Vector3 } from "three";

export type Projection = "perspective" | "orthographic";

/** Lengths are those of the scene, in which the longer side of the map is 1. */
export interface Eye {
  projection: Projection;
  /** Direction of the eye from the target, counter-clockwise from +x, in deg. */
  azimuthDeg: number;
  /** Above the horizon, in deg; 90 is straight down. */
  elevationDeg: number;
  /** Half the height of what is seen at the target. */
  reach: number;
  target: [number, number, number];
}

const FIELD_DEG = 30;
const FILLED = 0.93;

export const HOME: Readonly<Eye> = {
  projection: "perspective",
  azimuthDeg: -62,
  elevationDeg: 38,
  reach: 0.63,
  target: [0, 0, 0],
};

/** Straight down, the map's first row on top. */
export const TOP: Readonly<Eye> = { ...HOME, azimuthDeg: -90, elevationDeg: 90 };

/** Return the eye brought to where it just sees all of some points of the scene. */
export function fitted(eye: Eye, points: Vector3[], aspect: number): Eye {
  let found: Eye = { ...eye, target: [0, 0, 0], reach: 1 };
  // Perspective makes what is near larger, and so each step changes what the next one sees.
  for (let round = 0; round < 6; round++) {
    const camera = cameraOf(found, aspect);
    const seen = points.map((point) => point.clone().project(camera));
    const [xs, ys] = [seen.map((point) => point.x), seen.map((point) => point.y)];
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    found = moved(found, ((left + right) / 2) * aspect, (low + high) / 2);
    found = { ...found, reach: (found.reach * Math.max((right - left) / 2, (high - low) / 2)) / FILLED };
  }
  return found;
}

/** Return the direction from the target to the eye. */
export function directionOf(eye: Eye): Vector3 {
  const azimuth = (eye.azimuthDeg * Math.PI) / 180;
  const elevation = (eye.elevationDeg * Math.PI) / 180;
  return new Vector3(
    Math.cos(elevation) * Math.cos(azimuth),
    Math.cos(elevation) * Math.sin(azimuth),
    Math.sin(elevation),
  );
}

/** Return right and up of the picture in the scene. */
export function frameOf(eye: Eye): { right: Vector3; up: Vector3 } {
  const azimuth = (eye.azimuthDeg * Math.PI) / 180;
  const right = new Vector3(-Math.sin(azimuth), Math.cos(azimuth), 0);
  return { right, up: directionOf(eye).cross(right) };
}

/** Return a camera for an eye, turned sideways by `turnDeg` about the target for one eye of an anaglyph. */
export function cameraOf(eye: Eye, aspect: number, turnDeg = 0): PerspectiveCamera | OrthographicCamera {
  const turned = { ...eye, azimuthDeg: eye.azimuthDeg + turnDeg };
  const distance = eye.projection === "perspective" ? eye.reach / Math.tan((FIELD_DEG * Math.PI) / 360) : 6;
  const camera =
    eye.projection === "perspective"
      ? new PerspectiveCamera(FIELD_DEG, aspect, Math.max(0.002, distance - 4), distance + 4)
      : new OrthographicCamera(-eye.reach * aspect, eye.reach * aspect, eye.reach, -eye.reach, 0.01, 12);
  const direction = directionOf(turned);
  const target = new Vector3(...eye.target);
  camera.position.copy(target).addScaledVector(direction, distance);
  // At the pole "up" is where the azimuth says, so that straight down is no special case.
  camera.up.copy(frameOf(turned).up);
  camera.lookAt(target);
  camera.updateMatrixWorld();
  camera.updateProjectionMatrix();
  return camera;
}

/** Return the eye turned by so many degrees. */
export function turned(eye: Eye, azimuthDeg: number, elevationDeg: number): Eye {
  const azimuth = eye.azimuthDeg + azimuthDeg;
  return {
    ...eye,
    azimuthDeg: azimuth - 360 * Math.floor((azimuth + 180) / 360),
    elevationDeg: Math.min(90, Math.max(-89, eye.elevationDeg + elevationDeg)),
  };
}

/** Return the eye moved sideways, by shares of the picture's half height. */
export function moved(eye: Eye, right: number, up: number): Eye {
  const frame = frameOf(eye);
  const target = new Vector3(...eye.target)
    .addScaledVector(frame.right, right * eye.reach)
    .addScaledVector(frame.up, up * eye.reach);
  target.clampScalar(-1.5, 1.5);
  return { ...eye, target: [target.x, target.y, target.z] };
}

/** Return the eye nearer (factor below 1), such that what is at a place of the picture (-1 to 1, y up) stays there. */
export function zoomed(eye: Eye, factor: number, x = 0, y = 0, aspect = 1): Eye {
  const reach = Math.min(4, Math.max(0.004, eye.reach * factor));
  const left = 1 - reach / eye.reach;
  return { ...moved(eye, left * x * aspect, left * y), reach };
}
