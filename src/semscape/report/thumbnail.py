"""A small picture of a surface, for lists of many."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from semscape.report.hillshade import hillshade
from semscape.types import HeightMap


def thumbnail_png(height_map: HeightMap, longest_px: int) -> bytes:
    """Return the shaded relief as a grey PNG of at most so many px; unknown heights are transparent.

    Raises
    ------
    ValueError
        If the size is not positive.
    """
    if longest_px < 1:
        raise ValueError(f"longest_px must be at least 1, got {longest_px}")
    shade = hillshade(height_map.height_um, height_map.pixel_size_um)
    known = np.isfinite(shade)
    grey = np.rint(255 * np.clip(np.where(known, shade, 0.0), 0.0, 1.0)).astype(np.uint8)
    picture = Image.merge("LA", (Image.fromarray(grey), Image.fromarray((255 * known).astype(np.uint8))))
    picture.thumbnail((longest_px, longest_px), Image.Resampling.BOX)
    stream = io.BytesIO()
    picture.save(stream, "png", optimize=True)
    return stream.getvalue()
