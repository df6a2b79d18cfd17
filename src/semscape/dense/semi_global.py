"""Census costs and semi-global matching with a search range of its own for every pixel.

Census compares a pixel with its neighbours and so survives any monotonic change of brightness. Semi-global
matching (Hirschmueller 2008, doi:10.1109/TPAMI.2007.1166) sums the costs along eight directions; the range
per pixel, from a coarser level, keeps time and memory proportional to the image and not to the relief
(Rothermel et al. 2012, tSGM).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.types import BoolArray, FloatArray, ImageArray

CensusArray = NDArray[np.uint64]
Costs = NDArray[np.int32]

_UNKNOWN_COST = 24
_FAR = np.int32(1_000_000)
_STEEPEST_PRIOR = 2
_EDGE_WEIGHT = np.float32(0.5)


@njit(cache=True, nogil=True)
def census(image: ImageArray, radius: int) -> CensusArray:
    """Return for each pixel of (H, W) the bits "neighbour is darker" over its (2 radius + 1)^2 window, radius <= 3."""
    height, width = image.shape
    words = np.zeros((height, width), np.uint64)
    for row in range(radius, height - radius):
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                if dx != 0 or dy != 0:
                    for col in range(radius, width - radius):
                        darker = np.uint64(image[row + dy, col + dx] < image[row, col])
                        words[row, col] = (words[row, col] << np.uint64(1)) | darker
    return words


def match_rows(
    census1: CensusArray,
    valid1: BoolArray,
    census2: CensusArray,
    valid2: BoolArray,
    start: NDArray[np.int32],
    n_disparities: int,
    penalty_small: float,
    penalty_large: float,
) -> tuple[FloatArray, FloatArray]:
    """Match rows of image 1 to rows of image 2.

    Parameters
    ----------
    census1, census2 : (H, W) uint64 arrays
    valid1, valid2 : (H, W) bool arrays
        Where the images hold data.
    start : (H, W) int32 array
        Smallest disparity tried at each pixel, px; pixel (row, col) is sought at col + start .. + n - 1.
    n_disparities : int
        Number tried at each pixel.
    penalty_small, penalty_large : float
        Costs, in census bits, of a change of disparity by one and by more between neighbours.

    Returns
    -------
    disparity : (H, W) float array
        Sub-pixel disparity in px; NaN where image 1 is invalid or the best one lies at the end of the range.
    back : (H, W) float array
        Disparity from image 2 to image 1 in whole px, from the same costs; NaN where no range leads.
    """
    height, width = start.shape
    cost = np.empty((height, width, n_disparities), np.uint8)
    _matching_cost(census1, valid1, census2, valid2, start, cost)
    level = np.zeros((height, width), np.int32)
    plain = np.zeros((height, width), np.float32)
    total = _total_cost(cost, start, valid1, level, plain, penalty_small, penalty_large)
    disparity = np.empty(start.shape)
    _winner(total, start, valid1, disparity)
    return disparity, _seen_from_other_side(total, start, valid1)


def least_cost(
    cost: NDArray[np.uint8],
    start: NDArray[np.int32],
    valid: BoolArray,
    prior: NDArray[np.int32],
    guide: ImageArray,
    penalty_small: float,
    penalty_large: float,
) -> FloatArray:
    """Choose for every pixel the label of least cost that its neighbours support.

    Parameters
    ----------
    cost : (H, W, n) uint8 array
        Cost of the labels start .. start + n - 1.
    start : (H, W) int32 array
    valid : (H, W) bool array
        Where a label is wanted.
    prior : (H, W) int32 array
        Labels of a surface whose slope costs nothing (Scharstein et al. 2017); its jumps are not followed.
    guide : (H, W) float32 array
        Image, in units of its noise: a jump is the cheaper the more the image differs across it.
    penalty_small, penalty_large : float
        Costs of a change, beside that of the prior, by one label and by more.

    Returns
    -------
    (H, W) float array
        Label with a fraction, NaN where the best one lies at the end of its range.

    References
    ----------
    Hirschmueller 2008, doi:10.1109/TPAMI.2007.1166; Scharstein, Taniai & Sinha 2017, doi:10.1109/3DV.2017.00011.
    """
    total = _total_cost(cost, start, valid, prior, guide, penalty_small, penalty_large)
    label = np.empty(start.shape)
    _winner(total, start, valid, label)
    return label


def _total_cost(
    cost: NDArray[np.uint8],
    start: NDArray[np.int32],
    valid: BoolArray,
    prior: NDArray[np.int32],
    guide: ImageArray,
    penalty_small: float,
    penalty_large: float,
) -> NDArray[np.uint16]:
    total = np.zeros(cost.shape, np.uint16)
    small, large = np.int32(np.rint(penalty_small)), np.float32(np.rint(penalty_large))
    _aggregate(cost, start, valid, prior, guide, small, large, total, False)
    _aggregate(cost, start, valid, prior, guide, small, large, total, True)
    return total


@njit(cache=True, nogil=True)
def _matching_cost(
    census1: CensusArray,
    valid1: BoolArray,
    census2: CensusArray,
    valid2: BoolArray,
    start: NDArray[np.int32],
    cost: NDArray[np.uint8],
) -> None:
    height, width, n = cost.shape
    m1, m2 = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333)
    m4, ones = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101)
    for row in range(height):
        for col in range(width):
            first = col + start[row, col]
            for k in range(n):
                other = first + k
                if other < 0 or other >= width or not valid1[row, col] or not valid2[row, other]:
                    cost[row, col, k] = _UNKNOWN_COST
                    continue
                x = census1[row, col] ^ census2[row, other]
                x = x - ((x >> np.uint64(1)) & m1)
                x = (x & m2) + ((x >> np.uint64(2)) & m2)
                x = (x + (x >> np.uint64(4))) & m4
                cost[row, col, k] = (x * ones) >> np.uint64(56)


@njit(cache=True, nogil=True)
def _aggregate(
    cost: NDArray[np.uint8],
    start: NDArray[np.int32],
    valid: BoolArray,
    prior: NDArray[np.int32],
    guide: ImageArray,
    penalty_small: np.int32,
    penalty_large: np.float32,
    total: NDArray[np.uint16],
    backward: bool,
) -> None:
    """Add the costs along four directions: from the left and the three above, or their opposites.

    Paths begin and end where pixels are not valid. All costs are whole numbers, for which the compiler uses vectors.
    """
    height, width, n = cost.shape
    # Path costs of the previous and the current row, [path, column, label], between unreachable labels as wide as the
    # range itself: to a range that starts elsewhere leads another offset, and no branch.
    stride = 3 * n + 2
    middle = n + 1
    above = np.full(3 * width * stride, _FAR, np.int32)
    here = np.full(3 * width * stride, _FAR, np.int32)
    above_least = np.zeros((3, width), np.int32)
    here_least = np.zeros((3, width), np.int32)
    left = np.full(stride, _FAR, np.int32)
    side = np.full(stride, _FAR, np.int32)
    left_least = np.int32(0)
    own = np.empty(n, np.int32)
    summed = np.empty(n, np.int32)
    step = -1 if backward else 1
    for r in range(height):
        row = height - 1 - r if backward else r
        for c in range(width):
            col = width - 1 - c if backward else c
            if not valid[row, col]:
                continue
            for k in range(n):
                own[k] = cost[row, col, k]
                summed[k] = 0
            if c > 0 and valid[row, col - step]:
                shift = start[row, col] - start[row, col - step] - _slope(prior[row, col] - prior[row, col - step])
                large = _jump(penalty_small, penalty_large, guide[row, col], guide[row, col - step])
                at = middle + min(max(shift, -n), n)
                left_least = _extend(own, left, at, left_least, penalty_small, large, side, middle, summed)
            else:
                left_least = _begin(own, side, middle, summed)
            left, side = side, left
            for path in range(3):
                source = col + path - 1
                to = (path * width + col) * stride + middle
                if r > 0 and 0 <= source < width and valid[row - step, source]:
                    change = _slope(prior[row, col] - prior[row - step, source])
                    shift = start[row, col] - start[row - step, source] - change
                    large = _jump(penalty_small, penalty_large, guide[row, col], guide[row - step, source])
                    at = (path * width + source) * stride + middle + min(max(shift, -n), n)
                    least = above_least[path, source]
                    here_least[path, col] = _extend(own, above, at, least, penalty_small, large, here, to, summed)
                else:
                    here_least[path, col] = _begin(own, here, to, summed)
            for k in range(n):
                total[row, col, k] += np.uint16(summed[k])
        above, here = here, above
        above_least, here_least = here_least, above_least


@njit(cache=True, nogil=True, inline="always")
def _slope(change: int) -> int:
    """Return the change of the prior between neighbours, 0 where it jumps."""
    return change if abs(change) <= _STEEPEST_PRIOR else 0


@njit(cache=True, nogil=True, inline="always")
def _jump(penalty_small: np.int32, penalty_large: np.float32, value1: np.float32, value2: np.float32) -> np.int32:
    """Return what a jump costs between two grey values, a whole number."""
    contrast = np.float32(1) + _EDGE_WEIGHT * abs(value1 - value2)
    return np.int32(max(penalty_small, np.rint(penalty_large / contrast)))


# Neither function is inlined: as functions of their own the compiler turns their loops into vectors.
@njit(cache=True, nogil=True)
def _begin(own: Costs, path: Costs, to: int, summed: Costs) -> np.int32:
    least = _FAR
    n = len(own)
    new = path[to : to + n]
    for k in range(n):
        new[k] = own[k]
        summed[k] += own[k]
        least = min(least, own[k])
    return np.int32(least)


@njit(cache=True, nogil=True)
def _extend(
    own: Costs,
    before: Costs,
    at: int,
    before_least: np.int32,
    penalty_small: np.int32,
    penalty_large: np.int32,
    path: Costs,
    to: int,
    summed: Costs,
) -> np.int32:
    """Extend the path at `before[at :]` by one pixel into `path[to :]`; return the least of its new costs."""
    n = len(own)
    jump = np.int32(before_least + penalty_large)
    least = _FAR
    lower, same, upper = before[at - 1 : at - 1 + n], before[at : at + n], before[at + 1 : at + 1 + n]
    new = path[to : to + n]
    for k in range(n):
        best = np.int32(min(lower[k], upper[k]) + penalty_small)
        value = np.int32(own[k] + min(best, same[k], jump) - before_least)
        new[k] = value
        summed[k] += value
        least = min(least, value)
    return np.int32(least)


@njit(cache=True, nogil=True)
def _winner(total: NDArray[np.uint16], start: NDArray[np.int32], valid: BoolArray, disparity: FloatArray) -> None:
    height, width, n = total.shape
    for row in range(height):
        for col in range(width):
            best = 0
            for k in range(1, n):
                if total[row, col, k] < total[row, col, best]:
                    best = k
            if not valid[row, col] or best == 0 or best == n - 1:
                disparity[row, col] = np.nan
                continue
            left, middle, right = (
                float(total[row, col, best - 1]),
                float(total[row, col, best]),
                float(total[row, col, best + 1]),
            )
            # Census totals rise linearly about their least, so fit a V, not a parabola (less pixel locking).
            rise = max(left, right) - middle
            offset = (left - right) / (2 * rise) if rise > 0 else 0.0
            disparity[row, col] = start[row, col] + best + offset


@njit(cache=True, nogil=True)
def _seen_from_other_side(total: NDArray[np.uint16], start: NDArray[np.int32], valid: BoolArray) -> FloatArray:
    """Return the disparity (H, W) of least total cost at each pixel of image 2, in whole px, NaN where none leads."""
    height, width, n = total.shape
    disparity = np.full((height, width), np.nan)
    least = np.empty(width, np.uint16)
    for row in range(height):
        least[:] = np.uint16(65535)
        for col in range(width):
            if not valid[row, col]:
                continue
            first = col + start[row, col]
            for k in range(max(0, -first), min(n, width - first)):
                if total[row, col, k] < least[first + k]:
                    least[first + k] = total[row, col, k]
                    disparity[row, first + k] = -(start[row, col] + k)
    return disparity
