"""What a height costs: how far the views differ from the reference view there, in a small window, at every label."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semscape.types import BoolArray, FloatArray

# A difference between views is cut off at so many sigmas of noise; costs are counted in twentieths of a sigma.
LARGEST_DIFFERENCE = 3.0
_COST_UNIT = 20.0
# One side's views must agree better than all by this to be believed alone: they are fewer.
_ONE_SIDED = 0.4
_TAPS = 2


def window_taps(sigma_px: float) -> NDArray[np.float32]:
    """Return the taps (5,) of a Gaussian window.

    Examples
    --------
    >>> [f"{tap:.3f}" for tap in window_taps(0.8)]
    ['0.022', '0.229', '0.499', '0.229', '0.022']
    """
    taps = np.exp(-0.5 * (np.arange(-_TAPS, _TAPS + 1) / sigma_px) ** 2)
    return np.asarray(taps / taps.sum(), np.float32)


@njit(cache=True, nogil=True)
def fill_costs(
    cost: NDArray[np.uint8],
    first: NDArray[np.int32],
    step: float,
    wanted: BoolArray,
    around: BoolArray,
    images: NDArray[np.float32],
    view_from_grid: FloatArray,
    px_per_height: FloatArray,
    offset: NDArray[np.float32],
    side: NDArray[np.int64],
    taps: NDArray[np.float32],
) -> None:
    """Fill the cost (H, W, n) of the heights (first + k) step wherever `wanted`.

    Parameters
    ----------
    cost : (H, W, n) uint8 array
        Filled in place.
    first : (H, W) int32 array
    step : float
    wanted, around : (H, W) bool arrays
        Where costs are wanted, and the same two px wider.
    images : (V, rows, cols) float32 array
        Views in units of the noise, brought to one gain, NaN where masked; the last is the reference.
    view_from_grid, px_per_height : (V, 2, 3), (V, 2) float arrays
        Where the grid at height zero lies in each view, and its shift per unit of height.
    offset : (V - 1, H, W) float32 array
        How much brighter each view is than the reference, in units of the noise.
    side : (V - 1,) int array
        -1 or 1: on which side of the reference view a view looks from.
    taps : (5,) float32 array
    """
    height, width, n = cost.shape
    others = len(images) - 1
    difference = np.zeros((others, height, width), np.float32)
    own = np.empty(width, np.float32)
    below = np.empty((others, width), np.float32)
    on_side = np.array([(side == -1).sum(), (side == 1).sum()])
    for k in range(n):
        for row in range(height):
            for col in range(width):
                if around[row, col]:
                    h = (first[row, col] + k) * step
                    own[col] = _look(images[others], view_from_grid[others], px_per_height[others], row, col, h)
            for i in range(others):
                for col in range(width):
                    if around[row, col]:
                        h = (first[row, col] + k) * step
                        value = _look(images[i], view_from_grid[i], px_per_height[i], row, col, h)
                        apart = abs(value - offset[i, row, col] - own[col])
                        if np.isnan(apart):
                            apart = np.float32(LARGEST_DIFFERENCE / 2)
                        difference[i, row, col] = min(apart, np.float32(LARGEST_DIFFERENCE))
        for row in range(_TAPS, height - _TAPS):
            for i in range(others):
                for col in range(width):
                    below[i, col] = (
                        taps[0] * (difference[i, row - 2, col] + difference[i, row + 2, col])
                        + taps[1] * (difference[i, row - 1, col] + difference[i, row + 1, col])
                        + taps[2] * difference[i, row, col]
                    )
            for col in range(_TAPS, width - _TAPS):
                if not wanted[row, col]:
                    continue
                total, lower, upper = np.float32(0), np.float32(0), np.float32(0)
                for i in range(others):
                    mean = (
                        taps[0] * (below[i, col - 2] + below[i, col + 2])
                        + taps[1] * (below[i, col - 1] + below[i, col + 1])
                        + taps[2] * below[i, col]
                    )
                    total += mean
                    if side[i] < 0:
                        lower += mean
                    else:
                        upper += mean
                agreed = total / others
                if on_side[0] > 0 and on_side[1] > 0:
                    agreed = min(agreed, lower / on_side[0] + np.float32(_ONE_SIDED))
                    agreed = min(agreed, upper / on_side[1] + np.float32(_ONE_SIDED))
                cost[row, col, k] = np.uint8(np.rint(agreed * _COST_UNIT))


@njit(cache=True, nogil=True, inline="always")
def _look(
    image: NDArray[np.float32], affine: FloatArray, shift: FloatArray, row: int, col: int, height: float
) -> np.float32:
    """Return an image's value where a point of the grid is seen, between pixels; NaN outside."""
    x = affine[0, 0] * col + affine[0, 1] * row + affine[0, 2] + height * shift[0]
    y = affine[1, 0] * col + affine[1, 1] * row + affine[1, 2] + height * shift[1]
    if not (x >= 0 and y >= 0 and x < image.shape[1] - 1 and y < image.shape[0] - 1):
        return np.float32(np.nan)
    c, r = int(x), int(y)
    u, v = np.float32(x - c), np.float32(y - r)
    upper = image[r, c] + u * (image[r, c + 1] - image[r, c])
    lower = image[r + 1, c] + u * (image[r + 1, c + 1] - image[r + 1, c])
    return np.float32(upper + v * (lower - upper))
