"""Height and hybrid parameters of ISO 25178-2: Sa Sq Ssk Sku Sp Sv Sz, Sdq and Sdr.

All are over the known heights alone and about their mean; unknown heights are left out, never filled in. N known
heights z_i, mean removed:

    Sa = mean |z|     Sq = sqrt(mean z²)     Ssk = mean z³ / Sq³     Sku = mean z⁴ / Sq⁴
    Sp = max z        Sv = -min z            Sz = Sp + Sv

Sdq and Sdr depend on how a slope is taken from samples. Noise from pixel to pixel is the more slope the closer the
samples: on white noise the differences of neighbours give sqrt(2) / dx, central differences 1 / (sqrt(2) dx), half as
much. So the scheme is part of the value, and only values of one scheme and one S-filter compare.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from semscape.errors import NoAnswerError
from semscape.metrology.grid import Spacing, known_heights, spacing_xy
from semscape.types import BoolArray, FloatArray

SlopeScheme = Literal["forward", "central", "seven-point"]
"""How Sdq takes slopes: from neighbours (the default), over two steps, or by the 7-point formula of ISO 25178-2."""

_SEVEN_POINT = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60


def height_parameters(height: FloatArray) -> dict[str, float]:
    """Return Sa, Sq, Sp, Sv, Sz in the unit of the heights, and Ssk and Sku, which have none.

    Parameters
    ----------
    height : (H, W) float array
        Levelled (and filtered) heights, NaN = unknown.

    Returns
    -------
    dict
        By name. Ssk and Sku of a surface without any height difference are NaN.

    Raises
    ------
    NoAnswerError
        If no height is known.

    References
    ----------
    ISO 25178-2:2021, 4.2.

    Examples
    --------
    >>> height_parameters(np.array([[1.0, -1.0], [1.0, -1.0]]))["Sa"]
    1.0
    """
    z = known_heights(height)
    z = z - z.mean()
    squares = z * z
    variance = float(squares.mean())
    flat = variance <= 0
    highest, lowest = float(z.max()), float(z.min())
    return {
        "Sa": float(np.abs(z).mean()),
        "Sq": float(np.sqrt(variance)),
        "Ssk": np.nan if flat else float((squares * z).mean()) / variance**1.5,
        "Sku": np.nan if flat else float((squares * squares).mean()) / variance**2,
        "Sp": highest,
        "Sv": -lowest,
        "Sz": highest - lowest,
    }


def mean_heights(height: FloatArray) -> dict[str, float]:
    """Return Sa and Sq alone, for the many draws of a Monte Carlo."""
    z = known_heights(height)
    z = z - z.mean()
    return {"Sa": float(np.abs(z).mean()), "Sq": float(np.sqrt(np.mean(z * z)))}


def root_mean_square_slope(height: FloatArray, spacing: Spacing, scheme: SlopeScheme = "forward") -> float:
    """Return Sdq = sqrt(mean (dz/dx)² + mean (dz/dy)²), without unit.

    "forward": dz/dx = (z[j + 1] - z[j]) / dx, every pair of neighbours. "central": (z[j + 1] - z[j - 1]) / (2 dx).
    "seven-point": (z[j+3] - 9 z[j+2] + 45 z[j+1] - 45 z[j-1] + 9 z[j-2] - z[j-3]) / (60 dx), the formula that
    ISO 25178-2 names. Each is over the places where all its samples are known.

    Raises
    ------
    NoAnswerError
        If nowhere enough neighbours are known.

    Examples
    --------
    >>> plane = np.add.outer(0.2 * np.arange(9), 0.1 * np.arange(9))
    >>> [round(root_mean_square_slope(plane, 0.5, scheme), 6) for scheme in ("forward", "central", "seven-point")]
    [0.447214, 0.447214, 0.447214]
    """
    dx, dy = spacing_xy(spacing)
    total = 0.0
    for along_x, step in ((height, dx), (height.T, dy)):
        slope = _difference(along_x, scheme) / step
        known = np.isfinite(slope)
        if not known.any():
            raise NoAnswerError(f"no slope: nowhere are enough neighbouring heights known for {scheme} differences")
        total += float(np.mean(slope[known] ** 2))
    return float(np.sqrt(total))


def developed_areas(height: FloatArray, spacing: Spacing) -> tuple[float, float]:
    """Return the developed and the projected area in the square of the spacing's unit.

    Each cell between four known heights is cut into two triangles, along either diagonal, and the mean of both cuts
    counts; a cell with an unknown corner counts in neither area.

    Raises
    ------
    NoAnswerError
        If no cell is known.

    Examples
    --------
    >>> developed, projected = developed_areas(np.tile(np.arange(5.0), (3, 1)), 1.0)
    >>> round(developed / projected, 6)
    1.414214
    """
    dx, dy = spacing_xy(spacing)
    known_cells = _known_cells(np.isfinite(height))
    count = int(known_cells.sum())
    if count == 0:
        raise NoAnswerError("no area: nowhere are four neighbouring heights known")
    square_x = (np.diff(height, axis=1) / dx) ** 2
    square_y = (np.diff(height, axis=0) / dy) ** 2
    top, bottom, left, right = square_x[:-1], square_x[1:], square_y[:, :-1], square_y[:, 1:]
    total = 0.0
    # The four triangles of the two cuts: each has one edge along x and one along y, so those are its slopes.
    for along_x, along_y in ((top, left), (bottom, right), (top, right), (bottom, left)):
        total += float(np.sqrt(1 + along_x + along_y).sum(where=known_cells))
    return total / 4 * dx * dy, count * dx * dy


def developed_area_ratio(height: FloatArray, spacing: Spacing) -> float:
    """Return Sdr, developed over projected area less one, in percent (see developed_areas for the scheme)."""
    developed, projected = developed_areas(height, spacing)
    return 100 * (developed / projected - 1)


def _difference(height: FloatArray, scheme: SlopeScheme) -> FloatArray:
    if scheme == "forward":
        return np.diff(height, axis=1)
    reach = {"central": 1, "seven-point": 3}.get(scheme)
    if reach is None:
        raise ValueError(f"slope scheme {scheme!r} is not one of forward, central, seven-point")
    taps = np.array([-0.5, 0.0, 0.5]) if reach == 1 else _SEVEN_POINT
    width = height.shape[1] - 2 * reach
    if width < 1:
        return np.empty((height.shape[0], 0))
    slope = np.zeros((height.shape[0], width))
    for i, tap in enumerate(taps):
        if tap:
            slope += tap * height[:, i : i + width]
    return slope


def _known_cells(known: BoolArray) -> BoolArray:
    cells: BoolArray = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    return cells
