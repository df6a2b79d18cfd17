"""Rotations of the tilt geometry, in the project's one convention (docs/conventions.md)."""

from __future__ import annotations

import numpy as np

from semscape.types import FloatArray

CAM_FROM_WORLD_AT_ZERO_TILT: FloatArray = np.diag([1.0, -1.0, -1.0])


def axis_rotation(axis_angle_rad: FloatArray | float, tilt_rad: FloatArray | float) -> FloatArray:
    """Return the active right-handed rotation about an axis in the world's xy plane.

    Parameters
    ----------
    axis_angle_rad : (...) float array
        Direction of the axis from +x, counter-clockwise seen from the electron source.
    tilt_rad : (...) float array
        Tilt about the axis; broadcast against the axis.

    Returns
    -------
    (..., 3, 3) float array
        Rotation that takes world coordinates of the untilted specimen to those of the tilted one.

    Examples
    --------
    A positive tilt about +y moves a peak (0, 0, 1) to larger x:

    >>> bool(axis_rotation(np.pi / 2, 0.1)[0, 2] > 0)
    True
    """
    tilt = np.asarray(tilt_rad, dtype=np.float64)
    ax, ay = np.cos(axis_angle_rad), np.sin(axis_angle_rad)
    c, s = np.cos(tilt), np.sin(tilt)
    rotation = np.empty((*np.broadcast(ax, tilt).shape, 3, 3))
    rotation[..., 0, 0] = c + ax * ax * (1 - c)
    rotation[..., 0, 1] = ax * ay * (1 - c)
    rotation[..., 0, 2] = ay * s
    rotation[..., 1, 0] = ax * ay * (1 - c)
    rotation[..., 1, 1] = c + ay * ay * (1 - c)
    rotation[..., 1, 2] = -ax * s
    rotation[..., 2, 0] = -ay * s
    rotation[..., 2, 1] = ax * s
    rotation[..., 2, 2] = c
    return rotation


def roll_rotation(roll_rad: FloatArray | float) -> FloatArray:
    """Return the rotation (..., 3, 3) of the image about the camera's axis; positive turns +x towards +y."""
    roll = np.asarray(roll_rad, dtype=np.float64)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.zeros((*roll.shape, 3, 3))
    rotation[..., 0, 0] = c
    rotation[..., 0, 1] = -s
    rotation[..., 1, 0] = s
    rotation[..., 1, 1] = c
    rotation[..., 2, 2] = 1.0
    return rotation


def tilted_cam_from_world(
    axis_angle_rad: FloatArray | float, tilt_rad: FloatArray | float, roll_rad: FloatArray | float
) -> FloatArray:
    """Return R = Rz(roll) R_0 Rot(axis, tilt), (..., 3, 3): the rotation from world to camera."""
    rotation: FloatArray = (
        roll_rotation(roll_rad) @ CAM_FROM_WORLD_AT_ZERO_TILT @ axis_rotation(axis_angle_rad, tilt_rad)
    )
    return rotation


def wrap_axis_angle(axis_angle_rad: float) -> tuple[float, bool]:
    """Bring an axis direction into (-45, 135] deg; the flag says that its sense, so every tilt's sign, flipped.

    Examples
    --------
    >>> angle, flipped = wrap_axis_angle(np.deg2rad(-90.0))
    >>> round(float(np.rad2deg(angle))), flipped
    (90, True)
    """
    half_turns = np.ceil((axis_angle_rad - 0.75 * np.pi) / np.pi)
    return float(axis_angle_rad - half_turns * np.pi), bool(int(half_turns) % 2)
