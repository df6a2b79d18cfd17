"""Outliers: nothing is removed unless asked; what is removed becomes unknown, it is never replaced."""

from __future__ import annotations

import numpy as np
from numba import njit

from semscape.types import BoolArray, FloatArray

_REACH = 2
_MAD = 1.4826


def find_outliers(height: FloatArray, limit: float) -> BoolArray:
    """Return True where a height stands out from its neighbours.

    A height stands out if it differs from the median of the known heights in the 5 x 5 px around it by more than
    `limit` robust standard deviations (1.4826 MAD) of all such differences. Fewer than six known heights around it
    give no judgement.

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
    departure = np.abs(_from_median(np.ascontiguousarray(height, dtype=np.float64), _REACH))
    judged = np.isfinite(departure)
    if not judged.any():
        return np.zeros(height.shape, dtype=bool)
    sigma = _MAD * float(np.median(departure[judged]))
    outliers: BoolArray = judged & (departure > limit * sigma) & (departure > 0)
    return outliers


@njit(cache=True, nogil=True)
def _from_median(height: FloatArray, reach: int) -> FloatArray:  # pragma: no cover - compiled
    rows, cols = height.shape
    departure = np.full((rows, cols), np.nan)
    rising = np.empty((2 * reach + 1) ** 2)
    for row in range(rows):
        for col in range(cols):
            if np.isnan(height[row, col]):
                continue
            count = 0
            for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for c in range(max(col - reach, 0), min(col + reach + 1, cols)):
                    value = height[r, c]
                    if np.isnan(value):
                        continue
                    # Put in its place among those before it: so few are sorted fastest by insertion.
                    i = count
                    while i > 0 and rising[i - 1] > value:
                        rising[i] = rising[i - 1]
                        i -= 1
                    rising[i] = value
                    count += 1
            if count > 6:
                departure[row, col] = height[row, col] - 0.5 * (rising[(count - 1) // 2] + rising[count // 2])
    return departure
