"""Height maps as text: CSV, a line per row of the grid, and XYZ, a line per point. Both begin with comments (#)."""

from __future__ import annotations

import io

import numpy as np

from semscape.io.surfaces import describe_height_map, describe_mesh
from semscape.types import FloatArray, HeightMap


def encode_csv(height_map: HeightMap) -> bytes:
    """Return the heights (H, W) as CSV in the map's unit, nan where unknown, the first row at the largest y."""
    return _lines(describe_height_map(height_map), height_map.height_um, ",")


def encode_xyz(height_map: HeightMap) -> bytes:
    """Return the known points as lines `x y z` in the world frame and the map's unit; unknown heights are left out."""
    rows, columns = np.nonzero(np.isfinite(height_map.height_um))
    grid = np.column_stack([columns, rows, height_map.height_um[rows, columns], np.ones(len(rows))])
    points = (grid @ height_map.world_from_grid.T)[:, :3]
    return _lines(describe_mesh("height map", height_map.length_unit), points, " ")


def _lines(comment: str, table: FloatArray, delimiter: str) -> bytes:
    buffer = io.BytesIO()
    np.savetxt(buffer, table, fmt="%.9g", delimiter=delimiter, header=comment)
    return buffer.getvalue()
