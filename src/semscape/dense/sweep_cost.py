"""What a height costs: how far the views differ from the reference view there, in a small window, at every label."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.types import BoolArray, FloatArray

Row = NDArray[np.float32]

# A difference between views is cut off at so many sigmas of noise; costs are counted in twentieths of a sigma.
LARGEST_DIFFERENCE = 3.0
_COST_UNIT = 20.0
# One side's views must agree better than all by this to be believed alone: they are fewer.
_ONE_SIDED = 0.4
_TAPS = 2
_ROWS = 2 * _TAPS + 1
# Heights whose differences are held at a time, of five rows: they fit the cache.
_TOGETHER = 8


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
    rows: tuple[int, int],
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
    """Fill the cost of the heights (first + k) step in some rows of (H, W) wherever `wanted`.

    Parameters
    ----------
    rows : (int, int)
        The first row, and the one after the last.
    cost : (last - first, W, n) uint8 array
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
    height, width = first.shape
    n = cost.shape[2]
    top, bottom = rows
    others = len(images) - 1
    # On both sides, or on one alone: then there is no choice.
    share = np.array([1 / others, 0.0, 0.0], np.float32)
    if (side < 0).any() and (side > 0).any():
        share[1], share[2] = 1 / (side < 0).sum(), 1 / (side > 0).sum()
    views = images.reshape(others + 1, images.shape[1] * images.shape[2])
    size = images.shape[1:]
    shift = px_per_height.astype(np.float32)
    # Of the pixels of a row where costs are wanted, and around: column, lowest height, and place in each view.
    at, lowest = np.empty(width, np.int32), np.empty(width, np.float32)
    x, y = np.empty((others + 1, width), np.float32), np.empty((others + 1, width), np.float32)
    brighter = np.empty((others, width), np.float32)
    own, value = np.empty(width, np.float32), np.empty(width, np.float32)
    # Differences of the last rows, (height, row, view, column), and what becomes of them.
    ring = np.zeros((_TOGETHER, _ROWS, others, width), np.float32)
    below = np.empty(width, np.float32)
    means = np.empty((2, width), np.float32)
    agreed = np.empty((_TOGETHER, width), np.uint8)
    for k0 in range(0, n, _TOGETHER):
        together = min(_TOGETHER, n - k0)
        for row in range(max(top - _TAPS, 0), min(bottom, height) + _TAPS):
            count = 0
            for col in range(width if row < height else 0):
                if around[row, col]:
                    at[count], lowest[count] = col, np.float32(first[row, col] * step)
                    count += 1
            for i in range(others + 1):
                affine = view_from_grid[i]
                for m in range(count):
                    x[i, m] = np.float32(affine[0, 0] * at[m] + affine[0, 1] * row + affine[0, 2])
                    y[i, m] = np.float32(affine[1, 0] * at[m] + affine[1, 1] * row + affine[1, 2])
                    if i < others:
                        brighter[i, m] = offset[i, row, at[m]]
            for k in range(together if count else 0):
                up = np.float32((k0 + k) * step)
                _look(views[others], size, x[others, :count], y[others], lowest, up, shift[others], own)
                for i in range(others):
                    _look(views[i], size, x[i, :count], y[i], lowest, up, shift[i], value)
                    _difference(value, brighter[i], own, at[:count], ring[k, row % _ROWS, i])
            done = row - _TAPS
            if not max(top, _TAPS) <= done < height - _TAPS:
                continue
            left, right = width, 0
            for col in range(_TAPS, width - _TAPS):
                if wanted[done, col]:
                    left, right = min(left, col), col + 1
            if left >= right:
                continue
            wide = slice(left - _TAPS, right + _TAPS)
            for k in range(together):
                means[:] = 0
                for i in range(others):
                    lately = ring[k]
                    _down(
                        lately[(done - 2) % _ROWS, i, wide],
                        lately[(done - 1) % _ROWS, i, wide],
                        lately[done % _ROWS, i, wide],
                        lately[(done + 1) % _ROWS, i, wide],
                        lately[(done + 2) % _ROWS, i, wide],
                        taps,
                        below,
                    )
                    _along(below, taps, means[0 if side[i] < 0 else 1, left:right])
                _agreement(means[0, left:right], means[1, left:right], share, agreed[k, left:right])
            for col in range(left, right):
                if wanted[done, col]:
                    for k in range(together):
                        cost[done - top, col, k0 + k] = agreed[k, col]


# The loops below stand in functions of their own: only so the compiler turns them into vectors.
@njit(cache=True, nogil=True)
def _look(
    image: Row,
    size: tuple[int, int],
    x0: Row,
    y0: Row,
    lowest: Row,
    up: np.float32,
    shift: Row,
    value: Row,
) -> None:
    """Look up the values of an image, laid out in one row, at heights lowest + up; NaN outside."""
    rows, cols = size
    wide, last_x, last_y = np.int32(cols), np.float32(cols - 2), np.float32(rows - 2)
    shift_x, shift_y = shift[0], shift[1]
    for m in range(len(x0)):
        h = lowest[m] + up
        x, y = x0[m] + h * shift_x, y0[m] + h * shift_y
        # In front of the last but one, for the next row and column are needed, too.
        inside = (x >= 0) & (y >= 0) & (x < last_x + 1) & (y < last_y + 1)
        c = np.int32(min(max(x, np.float32(0)), last_x))
        r = np.int32(min(max(y, np.float32(0)), last_y))
        u, v = x - np.float32(c), y - np.float32(r)
        j = np.uint32(r * wide + c)
        here, right = image[j], image[j + np.uint32(1)]
        below, beyond = image[j + np.uint32(wide)], image[j + np.uint32(wide + 1)]
        upper, lower = here + u * (right - here), below + u * (beyond - below)
        value[m] = upper + v * (lower - upper) if inside else np.float32(np.nan)


@njit(cache=True, nogil=True)
def _difference(value: Row, brighter: Row, own: Row, at: NDArray[np.int32], difference: Row) -> None:
    """Put the differences into their columns, cut off; those of nothing to compare are middling."""
    most, middling = np.float32(LARGEST_DIFFERENCE), np.float32(LARGEST_DIFFERENCE / 2)
    for m in range(len(at)):
        apart = abs(value[m] - brighter[m] - own[m])
        difference[at[m]] = apart if apart < most else (most if apart >= most else middling)


@njit(cache=True, nogil=True, fastmath=True)
def _down(above2: Row, above: Row, row: Row, below: Row, below2: Row, taps: Row, mean: Row) -> None:
    outer, inner, middle = taps[0], taps[1], taps[2]
    for k in range(len(row)):
        mean[k] = outer * (above2[k] + below2[k]) + inner * (above[k] + below[k]) + middle * row[k]


@njit(cache=True, nogil=True, fastmath=True)
def _along(row: Row, taps: Row, total: Row) -> None:
    n = len(total)
    before2, before, here, after, after2 = row[:n], row[1 : n + 1], row[2 : n + 2], row[3 : n + 3], row[4 : n + 4]
    outer, inner, middle = taps[0], taps[1], taps[2]
    for k in range(n):
        total[k] += outer * (before2[k] + after2[k]) + inner * (before[k] + after[k]) + middle * here[k]


@njit(cache=True, nogil=True, fastmath=True)
def _agreement(lower: Row, upper: Row, share: Row, cost: NDArray[np.uint8]) -> None:
    """Turn the sums of the views on either side into costs; one side may decide alone."""
    alone = np.float32(_ONE_SIDED if share[1] > 0 else LARGEST_DIFFERENCE)
    both, first, second = share[0], share[1], share[2]
    for k in range(len(cost)):
        mean = (lower[k] + upper[k]) * both
        one = min(lower[k] * first, upper[k] * second) + alone
        mean = mean if mean < one else one
        cost[k] = np.uint8(np.int32(mean * np.float32(_COST_UNIT) + np.float32(0.5)))
