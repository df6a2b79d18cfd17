"""The places that a height map knows, as oriented points in the world of the whole object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion

from semscape.dense.groups import PlacedMap
from semscape.dense.mesh import grey_levels
from semscape.types import BoolArray, FloatArray

_MOST_OBLIQUE = np.cos(np.deg2rad(72.0))
# Beside a gap heights are the least sure, and slopes unknown.
_MARGIN_PX = 2


@dataclass(frozen=True, eq=False)
class Samples:
    """Places that maps know: points and normals (N, 3) in the world, area (N,), grey (N,), and cosine to the view."""

    points: FloatArray
    normals: FloatArray
    area: FloatArray
    grey: FloatArray
    squareness: FloatArray

    def only(self, rows: BoolArray, share: FloatArray) -> Samples:
        """Return some of them, rows (N,) bool; each area is divided by `share` (N,)."""
        return Samples(
            self.points[rows],
            self.normals[rows],
            self.area[rows] / share[rows],
            self.grey[rows],
            self.squareness[rows],
        )


def map_samples(placed: PlacedMap) -> Samples:
    """Return the places of a map that it sees squarely enough, away from its gaps."""
    height_map = placed.height_map
    pixel = height_map.pixel_size_um
    height = np.where(height_map.specimen, height_map.height_um, np.nan)
    by_row, by_col = (np.asarray(slope, np.float64) for slope in np.gradient(height / pixel))
    cosine = 1 / np.sqrt(1 + by_row**2 + by_col**2)
    used = binary_erosion(np.isfinite(height), iterations=_MARGIN_PX) & (np.nan_to_num(cosine) >= _MOST_OBLIQUE)
    row, col = np.nonzero(used)
    grid = np.column_stack([col, row, height[used], np.ones(len(row))])
    # The first row has the largest y: down the rows is down in y.
    normal = np.column_stack([-by_col[used], by_row[used], np.ones(len(row))]) * cosine[used][:, None]
    return Samples(
        (grid @ placed.world_from_grid.T)[:, :3],
        normal @ placed.world_from_group[:3, :3].T,
        pixel**2 / cosine[used],
        grey_levels(height_map.texture)[used].astype(np.float64),
        cosine[used],
    )
