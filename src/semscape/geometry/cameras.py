"""The scaled orthographic camera: x = A s R[:2] X + t, with A the scan anisotropy."""

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


def camera_matrices(motion: Motion) -> FloatArray:
    """Return the (V, 2, 3) projection matrices of a motion in px per um."""
    rotation = tilted_cam_from_world(motion.axis_angle_rad, motion.tilt_rad, motion.roll_rad)
    stretch = np.stack([1 + motion.anisotropy / 2, 1 - motion.anisotropy / 2], axis=-1)
    matrices: FloatArray = stretch[:, :, None] * motion.scale_px_per_um[:, None, None] * rotation[:, :2]
    return matrices


def cameras_of(motion: Motion) -> tuple[ScaledOrthographicCamera, ...]:
    """Return one camera per view of a motion."""
    return tuple(
        ScaledOrthographicCamera(matrix, translation)
        for matrix, translation in zip(camera_matrices(motion), motion.translation_px, strict=True)
    )
