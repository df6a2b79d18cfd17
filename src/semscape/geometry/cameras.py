"""Cameras: scaled orthographic, x = A s R[:2] X + t with A the scan anisotropy, and the same with weak perspective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from semscape.geometry.rotations import tilted_cam_from_world
from semscape.types import FloatArray, Motion


class Camera(Protocol):
    """Anything that projects world points to px."""

    def project(self, points_um: FloatArray) -> FloatArray:
        """Project (P, 3) world points to (P, 2) px."""
        ...

    def jacobian(self, points_um: FloatArray) -> FloatArray:
        """Return d px / d um, (P, 2, 3)."""
        ...


@dataclass(frozen=True)
class ScaledOrthographicCamera:
    """Parallel projection, the camera of a SEM at usual magnifications.

    Parameters
    ----------
    matrix : (2, 3) float array
        px per um: anisotropy, scale and rotation in one.
    translation_px : (2,) float array
        Image of the world's origin.

    Examples
    --------
    >>> camera = ScaledOrthographicCamera(np.array([[2.0, 0, 0], [0, -2.0, 0]]), np.zeros(2))
    >>> camera.project(np.array([[1.0, 1.0, 5.0]])).tolist()
    [[2.0, -2.0]]
    """

    matrix: FloatArray
    translation_px: FloatArray

    def project(self, points_um: FloatArray) -> FloatArray:
        """Project (P, 3) world points to (P, 2) px."""
        projected: FloatArray = points_um @ self.matrix.T + self.translation_px
        return projected

    def jacobian(self, points_um: FloatArray) -> FloatArray:
        """Return d px / d um, (P, 2, 3), the same for every point."""
        return np.broadcast_to(self.matrix, (len(points_um), 2, 3))


@dataclass(frozen=True)
class PerspectiveCamera:
    """Central projection from afar, with the scaled orthographic camera as its limit.

    x = c + (matrix X + t - c) / (1 + k R_3 X): what lies farther from the lens looks smaller, about the centre c.

    Parameters
    ----------
    matrix : (2, 3) float array
        px per um at the depth of the world's origin.
    translation_px : (2,) float array
        Image of the world's origin.
    inverse_depth_row : (3,) float array
        k R_3 in 1 / um: the third row of the rotation over the distance of the centre of projection.
    centre_px : (2,) float array
        Where the optical axis meets the image.

    Examples
    --------
    >>> camera = PerspectiveCamera(np.eye(2, 3), np.zeros(2), np.array([0, 0, 0.01]), np.zeros(2))
    >>> camera.project(np.array([[11.0, 0.0, 10.0]])).tolist()
    [[10.0, 0.0]]
    """

    matrix: FloatArray
    translation_px: FloatArray
    inverse_depth_row: FloatArray
    centre_px: FloatArray

    def project(self, points_um: FloatArray) -> FloatArray:
        """Project (P, 3) world points to (P, 2) px."""
        offset = points_um @ self.matrix.T + self.translation_px - self.centre_px
        projected: FloatArray = self.centre_px + offset / (1 + points_um @ self.inverse_depth_row)[:, None]
        return projected

    def jacobian(self, points_um: FloatArray) -> FloatArray:
        """Return d px / d um, (P, 2, 3)."""
        offset = points_um @ self.matrix.T + self.translation_px - self.centre_px
        depth = (1 + points_um @ self.inverse_depth_row)[:, None, None]
        derivative: FloatArray = (self.matrix - offset[:, :, None] * self.inverse_depth_row / depth) / depth
        return derivative


def camera_matrices(motion: Motion) -> FloatArray:
    """Return the (V, 2, 3) projection matrices of a motion in px per um."""
    rotation = tilted_cam_from_world(motion.axis_angle_rad, motion.tilt_rad, motion.roll_rad)
    stretch = np.stack([1 + motion.anisotropy / 2, 1 - motion.anisotropy / 2], axis=-1)
    matrices: FloatArray = stretch[:, :, None] * motion.scale_px_per_um[:, None, None] * rotation[:, :2]
    return matrices


def perspective_cameras_of(
    motion: Motion, inverse_distance_per_um: float, centre_px: FloatArray
) -> tuple[PerspectiveCamera, ...]:
    """Return one perspective camera per view, with the centre of projection at 1 / `inverse_distance_per_um`."""
    rotation = tilted_cam_from_world(motion.axis_angle_rad, motion.tilt_rad, motion.roll_rad)
    return tuple(
        PerspectiveCamera(matrix, translation, inverse_distance_per_um * row, centre_px)
        for matrix, translation, row in zip(camera_matrices(motion), motion.translation_px, rotation[:, 2], strict=True)
    )


def cameras_of(motion: Motion) -> tuple[ScaledOrthographicCamera, ...]:
    """Return one camera per view of a motion."""
    return tuple(
        ScaledOrthographicCamera(matrix, translation)
        for matrix, translation in zip(camera_matrices(motion), motion.translation_px, strict=True)
    )
