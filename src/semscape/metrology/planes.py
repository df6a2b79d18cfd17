"""Planes fitted to regions of a map, and the angle between two of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.errors import NoAnswerError
from semscape.metrology.grid import Spacing, spacing_xy
from semscape.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane in the world's axes (x right, y up, z towards the source): unit `normal` (3,), z > 0, and its misfit.

    `tilt_rad` is the angle between the normal and z; `residual_rms` is vertical, in the heights' unit.
    """

    normal: FloatArray
    tilt_rad: float
    residual_rms: float


def fit_plane(height: FloatArray, spacing: Spacing, region: BoolArray) -> Plane:
    """Fit a plane to the known heights of a region by least squares along z.

    Raises
    ------
    NoAnswerError
        If the region holds fewer than three known heights, or they lie on one line.

    Examples
    --------
    >>> ramp = np.tile(np.arange(10.0), (10, 1))
    >>> round(float(np.rad2deg(fit_plane(ramp, 1.0, np.ones((10, 10), bool)).tilt_rad)), 6)
    45.0
    """
    dx, dy = spacing_xy(spacing)
    rows, cols = np.nonzero(region & np.isfinite(height))
    z = height[rows, cols]
    if len(z) < 3 or np.ptp(rows) == 0 or np.ptp(cols) == 0:
        raise NoAnswerError(f"the region of a plane holds {len(z)} known heights, need 3 that are not in line")
    design = np.column_stack([(cols - cols.mean()) * dx, -(rows - rows.mean()) * dy, np.ones_like(z)])
    solution, _, rank, _ = np.linalg.lstsq(design, z - z.mean(), rcond=None)
    if rank < 3:
        raise NoAnswerError("the known heights of the region lie on one line; choose a wider one")
    normal = np.array([-solution[0], -solution[1], 1.0])
    residual = z - z.mean() - design @ solution
    return Plane(
        normal / np.linalg.norm(normal),
        float(np.arctan(np.hypot(solution[0], solution[1]))),
        float(np.sqrt((residual**2).mean())),
    )


def angle_between(first: Plane, second: Plane) -> float:
    """Return the angle between two planes' normals in rad, 0 to pi.

    Examples
    --------
    >>> level = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 0.0)
    >>> angle_between(level, level)
    0.0
    """
    across = float(np.linalg.norm(np.cross(first.normal, second.normal)))
    return float(np.arctan2(across, float(first.normal @ second.normal)))
