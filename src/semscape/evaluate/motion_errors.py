"""Errors of the tilts and rotations of a series against the true ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semscape.evaluate.units import rounded
from semscape.geometry.rotations import tilted_cam_from_world
from semscape.types import FloatArray, Motion, SimulationTruth


def geodesic_rad(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angle (...) in rad of the rotation that takes `second` to `first`, both (..., 3, 3).

    Examples
    --------
    >>> quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    >>> round(float(np.rad2deg(geodesic_rad(quarter, np.eye(3)))), 6)
    90.0
    """
    between = first @ np.swapaxes(second, -1, -2)
    angle: FloatArray = Rotation.from_matrix(between.reshape(-1, 3, 3)).magnitude().reshape(between.shape[:-2])
    return angle


def rotation_errors_rad(motion: Motion, reference: int, true_motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Return each view's geodesic rotation error (V,): in the world, and relative to the reference view.

    The second is free of a common turn of all views, which no image can tell; it is 0 for the reference itself.
    """
    found, true = (
        tilted_cam_from_world(item.axis_angle_rad, item.tilt_rad, item.roll_rad) for item in (motion, true_motion)
    )
    relative = geodesic_rad(found @ found[reference].T, true @ true[reference].T)
    relative[reference] = 0.0
    return geodesic_rad(found, true), relative


def tilt_figures(motion: Motion, reference: int, truth: SimulationTruth) -> dict[str, Any]:
    """Return the tilt and rotation errors in deg: as they are, without what no image can tell, and the stage's own."""
    error = np.rad2deg(motion.tilt_rad - truth.motion.tilt_rad)
    stage = np.rad2deg(truth.stage_tilt_rad - truth.motion.tilt_rad)
    # What the stage alone can tell: a common turn, and the height scale, to which all tilts are proportional.
    true_tilt = np.rad2deg(truth.motion.tilt_rad)
    design = np.column_stack([np.ones(len(error)), true_tilt - true_tilt.mean()])
    seen_by_images = error - design @ np.linalg.lstsq(design, error, rcond=None)[0]
    # Heights are as much too large as the tilts' spread is too small.
    spread = true_tilt - true_tilt.mean()
    found_spread = float(np.rad2deg(motion.tilt_rad) @ spread)
    scale = float(spread @ spread) / found_spread if found_spread else np.nan
    rotation, relative = (np.rad2deg(item) for item in rotation_errors_rad(motion, reference, truth.motion))
    others = np.delete(relative, reference)
    return {
        "tilt_error_deg": _list(error),
        "tilt_error_without_common_deg": _list(error - error.mean()),
        "largest_tilt_error_without_common_deg": rounded(float(np.abs(error - error.mean()).max()), 4),
        "tilt_rms_error_deg": rounded(_rms(error), 4),
        "tilt_step_rms_error_deg": rounded(_rms(np.diff(error)), 4),
        "largest_tilt_error_that_images_show_deg": rounded(float(np.abs(seen_by_images).max()), 4),
        "height_scale_error_of_tilts_percent": rounded(100 * (scale - 1), 4),
        "stage_tilt_error_deg": _list(stage),
        "stage_tilt_rms_error_deg": rounded(_rms(stage), 4),
        "stage_tilt_step_rms_error_deg": rounded(_rms(np.diff(stage)), 4),
        "rotation_error_deg": _list(rotation),
        "rotation_rms_error_deg": rounded(_rms(rotation), 4),
        "relative_rotation_error_deg": _list(relative),
        "relative_rotation_rms_error_deg": rounded(_rms(others), 4),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _list(values: FloatArray) -> list[float]:
    return [rounded(float(value), 4) for value in values]
