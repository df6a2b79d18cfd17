"""Outliers: nothing is removed unless asked; what is removed becomes unknown, it is never replaced."""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.types import BoolArray, FloatArray

_REACH, _LEAST_PAIRS = 2, 3
_MAD = 1.4826


def find_outliers(height: FloatArray, limit: float) -> BoolArray:
    """Return True where a height stands out from its neighbours.

    A height stands out if it differs from its known neighbours in the 5 x 5 px around it, by both of two measures, by
    more than `limit` robust standard deviations (1.4826 MAD) of all such differences: from their median, which holds
    at a step, and from the median of the means of opposite neighbours, which holds on a slope. With fewer than three
    pairs of opposite neighbours, as along the frame, there is no judgement.

    Parameters
    ----------
    height : (H, W) float array
        Heights, NaN = unknown.
    limit : float
        Number of robust standard deviations; 6 is usual.

    Examples
    --------
    >>> map_um = np.random.default_rng(0).normal(0, 0.1, (40, 40))
    >>> map_um[20, 20] = 5.0
    >>> np.argwhere(find_outliers(map_um, 6.0)).tolist()
    [[20, 20]]
    """
    if not limit > 0:
        raise ValueError(f"the limit of outliers must be positive, got {limit}")
    departure = _departure(np.ascontiguousarray(height, dtype=np.float64), _REACH, _LEAST_PAIRS)
    judged = np.isfinite(departure)
    if not judged.any():
        return np.zeros(height.shape, dtype=bool)
    sigma = _MAD * float(np.median(departure[judged]))
    outliers: BoolArray = judged & (departure > limit * sigma) & (departure > 0)
    return outliers


@njit(cache=True, nogil=True)
def _insert(rising: FloatArray, count: int, value: float) -> int:  # pragma: no cover - compiled
    """Put a value in its place among `count` rising ones: so few are sorted fastest by insertion."""
    i = count
    while i > 0 and rising[i - 1] > value:
        rising[i] = rising[i - 1]
        i -= 1
    rising[i] = value
    return count + 1


@njit(cache=True, nogil=True)
def _departure(height: FloatArray, reach: int, least: int) -> FloatArray:  # pragma: no cover - compiled
    rows, cols = height.shape
    departure = np.full((rows, cols), np.nan)
    single, paired = np.empty((2 * reach + 1) ** 2), np.empty((2 * reach + 1) ** 2)
    for row in range(rows):
        for col in range(cols):
            value = height[row, col]
            if np.isnan(value):
                continue
            n, m = 0, 0
            for dr in range(0, reach + 1):
                for dc in range(-reach, reach + 1):
                    if dr == 0 and dc <= 0:
                        continue  # each pair of opposite neighbours once
                    first, second = np.nan, np.nan
                    if row + dr < rows and 0 <= col + dc < cols:
                        first = height[row + dr, col + dc]
                    if row - dr >= 0 and 0 <= col - dc < cols:
                        second = height[row - dr, col - dc]
                    if not np.isnan(first):
                        n = _insert(single, n, first)
                    if not np.isnan(second):
                        n = _insert(single, n, second)
                    if not np.isnan(first + second):
                        m = _insert(paired, m, 0.5 * (first + second))
            if m >= least:
                from_single = abs(value - 0.5 * (single[(n - 1) // 2] + single[n // 2]))
                from_paired = abs(value - 0.5 * (paired[(m - 1) // 2] + paired[m // 2]))
                departure[row, col] = min(from_single, from_paired)
    return departure
