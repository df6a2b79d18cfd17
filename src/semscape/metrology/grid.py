"""The grid under a height map: its spacing, and rectangles of it.

Coordinates here are those of the image: x right, y down, the centre of the top-left pixel at (0, 0), in px or,
times the spacing, in the map's unit of length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.errors import NoAnswerError
from semscape.types import BoolArray, FloatArray

Spacing = float | tuple[float, float]
"""Grid spacing: one number, or (dx, dy)."""


@dataclass(frozen=True)
class Region:
    """A rectangle of the image in px, edges included: a pixel whose centre lies in it belongs to it."""

    x0_px: float
    y0_px: float
    x1_px: float
    y1_px: float

    def mask(self, shape: tuple[int, int]) -> BoolArray:
        """Return (H, W) True inside."""
        rows, cols = np.ogrid[: shape[0], : shape[1]]
        inside_x = (cols >= min(self.x0_px, self.x1_px)) & (cols <= max(self.x0_px, self.x1_px))
        inside_y = (rows >= min(self.y0_px, self.y1_px)) & (rows <= max(self.y0_px, self.y1_px))
        inside: BoolArray = inside_x & inside_y
        return inside

    def scaled(self, factor: float) -> Region:
        """Return the same rectangle in an image whose pixel (0, 0) stays and whose spacing is 1 / `factor` of this."""
        return Region(self.x0_px * factor, self.y0_px * factor, self.x1_px * factor, self.y1_px * factor)


def spacing_xy(spacing: Spacing) -> tuple[float, float]:
    """Return (dx, dy), both positive.

    Raises
    ------
    ValueError
        If the spacing is not positive and finite.
    """
    dx, dy = spacing if isinstance(spacing, tuple) else (spacing, spacing)
    if not (0 < dx < np.inf and 0 < dy < np.inf):
        raise ValueError(f"the grid spacing must be positive, got {spacing}")
    return float(dx), float(dy)


def known_heights(height: FloatArray, least: int = 1) -> FloatArray:
    """Return the known heights as a flat array.

    Raises
    ------
    NoAnswerError
        If fewer than `least` are known.
    """
    if height.ndim != 2:
        raise ValueError(f"a height map has two dimensions, got shape {height.shape}")
    known: FloatArray = height[np.isfinite(height)]
    if len(known) < least:
        raise NoAnswerError(f"{len(known)} of {height.size} heights are known, need {least}; choose a larger region")
    return known
