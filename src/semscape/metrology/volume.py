"""Volumes above and below a level, and distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.metrology.grid import Spacing, known_heights, spacing_xy
from semscape.types import FloatArray


@dataclass(frozen=True)
class Volumes:
    """Volume of material above a level and of voids below it, and the area that was known and the area that was not."""

    above: float
    below: float
    known_area: float
    unknown_area: float


def volumes(height: FloatArray, spacing: Spacing, level: float = 0.0) -> Volumes:
    """Return the volumes between heights and a level: sum of max(z - level, 0) dx dy, and of max(level - z, 0) dx dy.

    Every known height stands for its whole pixel. Unknown pixels count in neither volume; their area is returned, for
    the volume that may be missing.

    Raises
    ------
    NoAnswerError
        If no height is known.

    Examples
    --------
    >>> volumes(np.array([[2.0, -1.0], [0.0, np.nan]]), 0.5)
    Volumes(above=0.5, below=0.25, known_area=0.75, unknown_area=0.25)
    """
    dx, dy = spacing_xy(spacing)
    z = known_heights(height) - level
    pixel = dx * dy
    return Volumes(
        above=float(np.maximum(z, 0).sum()) * pixel,
        below=float(np.maximum(-z, 0).sum()) * pixel,
        known_area=len(z) * pixel,
        unknown_area=(height.size - len(z)) * pixel,
    )


@dataclass(frozen=True)
class Distance:
    """Distance between two points of the surface: in the image plane, in height (second less first), and in space."""

    lateral: float
    vertical: float
    spatial: float


def distance(height: FloatArray, spacing: Spacing, xy1_px: FloatArray, xy2_px: FloatArray) -> Distance:
    """Return the distance between two points of the surface, given by their place in the image in px.

    Heights are interpolated bilinearly; the vertical distance is NaN where a point's surroundings are unknown.

    Examples
    --------
    >>> plane = np.tile(np.arange(5.0), (5, 1))
    >>> distance(plane, 1.0, np.array([0.0, 1.0]), np.array([3.0, 1.0]))
    Distance(lateral=3.0, vertical=3.0, spatial=4.24...)
    """
    from semscape.metrology.profile import sample_heights

    dx, dy = spacing_xy(spacing)
    first, second = sample_heights(height, np.array([xy1_px, xy2_px], dtype=np.float64))
    lateral = float(np.hypot((xy2_px[0] - xy1_px[0]) * dx, (xy2_px[1] - xy1_px[1]) * dy))
    vertical = float(second - first)
    return Distance(lateral, vertical, float(np.hypot(lateral, vertical)))
