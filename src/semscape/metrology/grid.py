"""The grid under a height map: its spacing, and rectangles and polygons of it.

Coordinates here are those of the image: x right, y down, the centre of the top-left pixel at (0, 0), in px or,
times the spacing, in the map's unit of length.
"""

from __future__ import annotations

from collections.abc import Sequence
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

    def box(self) -> FloatArray:
        """Return the least and the largest (x, y) in px."""
        return np.sort(np.array([[self.x0_px, self.y0_px], [self.x1_px, self.y1_px]]), axis=0)

    def scaled(self, factor: float) -> Region:
        """Return the same rectangle in an image whose pixel (0, 0) stays and whose spacing is 1 / `factor` of this."""
        return Region(self.x0_px * factor, self.y0_px * factor, self.x1_px * factor, self.y1_px * factor)

    def shifted(self, x_px: float, y_px: float) -> Region:
        """Return the same rectangle in an image whose pixel (0, 0) is this one's (x, y)."""
        return Region(self.x0_px - x_px, self.y0_px - y_px, self.x1_px - x_px, self.y1_px - y_px)


@dataclass(frozen=True)
class Polygon:
    """A polygon of the image by its corners (x, y) in px, edges included: a pixel belongs to it by its centre.

    Where its edges cross, what they enclose twice is outside (even-odd).

    Examples
    --------
    >>> Polygon(((0.0, 0.0), (4.0, 0.0), (0.0, 4.0))).mask((5, 5)).astype(int)
    array([[1, 1, 1, 1, 1],
           [1, 1, 1, 1, 0],
           [1, 1, 1, 0, 0],
           [1, 1, 0, 0, 0],
           [1, 0, 0, 0, 0]])
    """

    corners_px: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.corners_px) < 3:
            raise ValueError(f"a polygon has three corners or more, got {len(self.corners_px)}")

    def mask(self, shape: tuple[int, int]) -> BoolArray:
        """Return (H, W) True inside."""
        rows, cols = np.arange(shape[0], dtype=np.float64), np.arange(shape[1], dtype=np.float64)
        start = np.array(self.corners_px, dtype=np.float64)
        end = np.roll(start, -1, axis=0)
        crossings = np.full((shape[0], len(start)), np.inf)
        inside = np.zeros(shape, dtype=bool)
        for k, ((x0, y0), (x1, y1)) in enumerate(zip(start, end, strict=True)):
            crossed = (y0 > rows) != (y1 > rows)
            if y0 != y1:
                crossings[crossed, k] = x0 + (rows[crossed] - y0) * (x1 - x0) / (y1 - y0)
            # An edge along a row, and a corner that only touches it, are crossed by none.
            last = x1 if y0 == y1 else x0
            inside[np.ix_(rows == y0, (cols >= min(x0, last)) & (cols <= max(x0, last)))] = True
        crossings.sort(axis=1)
        for left, right in zip(crossings[:, :-1:2].T, crossings[:, 1::2].T, strict=True):
            inside |= (cols >= left[:, None]) & (cols <= right[:, None])
        return inside

    def box(self) -> FloatArray:
        """Return the least and the largest (x, y) in px."""
        return np.array([np.min(self.corners_px, axis=0), np.max(self.corners_px, axis=0)])

    def scaled(self, factor: float) -> Polygon:
        """Return the same polygon in an image whose pixel (0, 0) stays and whose spacing is 1 / `factor` of this."""
        return Polygon(tuple((x * factor, y * factor) for x, y in self.corners_px))

    def shifted(self, x_px: float, y_px: float) -> Polygon:
        """Return the same polygon in an image whose pixel (0, 0) is this one's (x, y)."""
        return Polygon(tuple((x - x_px, y - y_px) for x, y in self.corners_px))


def region_of(places_px: Sequence[float]) -> Region | Polygon:
    """Return the rectangle between two opposite corners x0, y0, x1, y1, or the polygon of three corners and more.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if len(places_px) == 4:
        x0, y0, x1, y1 = places_px
        return Region(x0, y0, x1, y1)
    if len(places_px) < 6 or len(places_px) % 2:
        raise ValueError(f"a region is x0, y0, x1, y1, or three corners x, y and more; got {len(places_px)} numbers")
    return Polygon(tuple(zip(places_px[::2], places_px[1::2], strict=True)))


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
