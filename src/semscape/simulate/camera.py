"""The simulated microscope's camera: a scanned beam, parallel or from a pivot at the working distance.

A point X (um) is imaged at

    x = D p (R X) + t        D = s [[1, skew], [0, 1]] diag(1 + a/2, 1 - a/2)

where p keeps the first two coordinates in the camera's frame and, with a working distance w, multiplies them by
w / (w + depth): the magnification is the nominal one in the eucentric plane, higher above it and lower below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from semscape.geometry.rotations import tilted_cam_from_world
from semscape.types import FloatArray, Motion


@dataclass(frozen=True, eq=False)
class ScanCamera:
    """One view's camera.

    Parameters
    ----------
    rotation : (3, 3) float array
        From the world to the camera, whose z axis points along the beam, away from the electron source.
    scan : (2, 2) float array
        The scan D: px per um, with magnification, anisotropy and skew.
    translation_px : (2,) float array
        Image of the world's origin.
    working_distance_um : float
        Distance of the beam's pivot from the world's origin; infinite for parallel projection.

    Examples
    --------
    A point 100 um above the plane of focus, seen from 1 mm, is magnified by 1 / (1 - 0.1):

    >>> camera = ScanCamera(np.diag([1.0, -1.0, -1.0]), np.eye(2), np.zeros(2), 1000.0)
    >>> camera.project(np.array([[9.0, 0.0, 100.0]])).tolist()
    [[10.0, 0.0]]
    """

    rotation: FloatArray
    scan: FloatArray
    translation_px: FloatArray
    working_distance_um: float = math.inf

    def project(self, points_um: FloatArray) -> FloatArray:
        """Image points (N, 3) in the world's frame; (N, 2) px."""
        seen = points_um @ self.rotation.T
        flat = seen[:, :2] / (1.0 + seen[:, 2:] / self.working_distance_um)
        imaged: FloatArray = flat @ self.scan.T + self.translation_px
        return imaged

    def rays(self, xy_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (N, 3) on the beams through pixels (N, 2), and the beams' directions, away from the source.

        The points lie in the plane through the world's origin that the optical axis meets at a right angle; the
        directions are unit vectors, (1, 3) where they are parallel, else (N, 3).
        """
        flat = (xy_px - self.translation_px) @ np.linalg.inv(self.scan).T
        points = flat @ self.rotation[:2]
        if math.isinf(self.working_distance_um):
            return points, self.rotation[2:3].copy()
        directions = points + self.working_distance_um * self.rotation[2]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return points, directions


def scan_cameras(motion: Motion, skew: tuple[float, ...], working_distance_um: float) -> tuple[ScanCamera, ...]:
    """Return the camera of each view of a motion; `skew` per view, the working distance infinite for parallel beams."""
    rotations = tilted_cam_from_world(motion.axis_angle_rad, motion.tilt_rad, motion.roll_rad)
    cameras = []
    for view, rotation in enumerate(rotations):
        stretch = np.diag([1 + motion.anisotropy[view] / 2, 1 - motion.anisotropy[view] / 2])
        shear = np.array([[1.0, skew[view]], [0.0, 1.0]])
        scan = motion.scale_px_per_um[view] * shear @ stretch
        cameras.append(ScanCamera(rotation, scan, motion.translation_px[view], working_distance_um))
    return tuple(cameras)
