"""Heights in metres, as the formats of metrology want them."""

from __future__ import annotations

import numpy as np

from semscape.errors import BadInputError
from semscape.io.surfaces import NEEDS_PIXEL_SIZE
from semscape.types import FloatArray, HeightMap


def heights_in_metres(height_map: HeightMap, file_format: str) -> tuple[FloatArray, float]:
    """Return heights (H, W) in metres, NaN where unknown, first row = largest y, and the grid spacing in metres.

    Raises
    ------
    BadInputError
        If the map is in px, or holds no height at all.

    Examples
    --------
    >>> flat = np.full((1, 2), 3.0)
    >>> flat_map = HeightMap(flat, flat, np.ones((1, 2), np.uint8), flat.astype(np.float32), 0.5, np.eye(4), "um")
    >>> heights_in_metres(flat_map, "X3P")
    (array([[3.e-06, 3.e-06]]), 5e-07)
    """
    if height_map.length_unit == "px":
        raise BadInputError(
            f"{file_format} holds heights in metres, but the run has no pixel size: {NEEDS_PIXEL_SIZE}, or convert to "
            "npz, tif, csv, xyz, vts or a mesh, which say that their lengths are in px"
        )
    if not np.isfinite(height_map.height_um).any():
        raise BadInputError(f"the height map holds no height at all, so there is nothing to write as {file_format}")
    return height_map.height_um * 1e-6, float(height_map.pixel_size_um) * 1e-6
