"""The most probable surface: heights of which all views agree, smooth as far as the data say that the surface is.

Every pixel's height has a stiffness k (how fast the views' disagreement grows with it, over its noise) and a pull.
The prior is second-order smoothness: differences D h of second order are noise of variance tau^2, of its own at
every place, and it is cut at depth jumps. The most probable heights solve (k + D' W D / tau^2) h = k h0 + pull.
tau^2 is not chosen: it is the one that makes the data most probable (MacKay 1992), by the fixed point
tau^2 = mean (D2 h)^2 / gamma. D2 are second differences over two pixels, for blurred images say nothing about finer
ones and those would make every surface smooth; gamma, what the data determine of them in units of tau^2, follows from
k tau^2. Further terms may tell slopes (`dense.slopes`): a precision s of theirs counts as k does, times the response to
a wave.

References: MacKay 1992, doi:10.1162/neco.1992.4.3.415.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.ndimage import map_coordinates

from semscape.compiled import njit
from semscape.dense.multilevel import Plane, answer, inverse_diagonals
from semscape.dense.sampling import gaussian_window
from semscape.dense.slopes import SlopeTerm, response
from semscape.types import BoolArray, FloatArray

_LOCAL_PX = 8.0
_STIFFNESS_PX = 4.0
_STUDENT = 4.0
# A power of the fixed point's step: it converges slowly.
_HASTE = 2.0
_TOLERANCE = 1e-4
_STEPS, _LEVELS = 30, 5
_LATTICE = 32
_FREQUENCY = np.pi * (np.arange(_LATTICE) + 0.5) / _LATTICE
# Of waves along the diagonal, rad per px along rows and columns.
_WAVES, _WAVE_COUNT = (0.01, np.pi), 300
_LOG_X, _LOG_Y, _LOG_STEP = (-12.0, 18.0), (-14.0, 16.0), 0.5


@dataclass(frozen=True)
class DataTerm:
    """Precision k (H, W) of every pixel's height by itself, and k times where the data pull it from its present one."""

    stiffness: FloatArray
    pull: FloatArray


def smoothness_cut(height: FloatArray, limit: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return weights (H, W) 1 or 0 of the second differences xx, yy, xy: 0 across steps beyond `limit` or NaN."""
    with np.errstate(invalid="ignore"):
        along = np.abs(np.diff(height, axis=1)) <= limit
        down = np.abs(np.diff(height, axis=0)) <= limit
    xx, yy, xy = (np.zeros(height.shape) for _ in range(3))
    xx[:, 1:-1] = along[:, :-1] & along[:, 1:]
    yy[1:-1] = down[:-1] & down[1:]
    xy[:-1, :-1] = along[:-1] & along[1:] & down[:, :-1] & down[:, 1:]
    return xx, yy, xy


def second_differences(height: FloatArray, over: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the second differences xx, yy (at their middle) and xy (at its upper left), (H, W), 0 at the border.

    They are taken over `over` pixels; those of xy for more than one pixel stand at their middle, too.
    """
    xx, yy, xy = (np.zeros(height.shape) for _ in range(3))
    n = over
    xx[:, n:-n] = height[:, : -2 * n] - 2 * height[:, n:-n] + height[:, 2 * n :]
    yy[n:-n] = height[: -2 * n] - 2 * height[n:-n] + height[2 * n :]
    first = n // 2
    rows, cols = (slice(first, size - n + first) for size in height.shape)
    xy[rows, cols] = height[:-n, :-n] - height[:-n, n:] - height[n:, :-n] + height[n:, n:]
    return xx, yy, xy


def _cut_over_two(cut: tuple[FloatArray, FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights of second differences over two pixels: 0 where one over one pixel within them is cut."""
    xx, yy, xy = (np.zeros(weight.shape) for weight in cut)
    xx[:, 1:-1] = cut[0][:, :-2] * cut[0][:, 2:]
    yy[1:-1] = cut[1][:-2] * cut[1][2:]
    xy[1:, 1:] = cut[2][1:, 1:] * cut[2][:-1, 1:] * cut[2][1:, :-1] * cut[2][:-1, :-1]
    return xx, yy, xy


class LatticeTable:
    """What a prior of second differences leaves open, for a stiffness that is the same everywhere.

    With x = k tau^2, y = s tau^2, R the response of slopes, and S, S2 the squared responses of the second differences
    over one pixel and over two, data weigh z = x + y R: `determined` is the mean of S2 / S z / (z + S) over all
    frequencies, `whole` its limit for exact data, and the variance of a height is tau^2 times `spread`, the mean of
    1 / (z + S).

    Examples
    --------
    Data that are stiff beside the prior determine everything, and slopes that are told more than none:

    >>> table = LatticeTable()
    >>> bool(table.determined(np.array(1e7)) > 0.99 * table.whole)
    True
    >>> bool(abs(table.spread(np.array(1e7)) * 1e7 - 1) < 0.01)
    True
    >>> bool(table.spread(np.array(1e-3), np.array(10.0)) < 0.5 * table.spread(np.array(1e-3)))
    True
    """

    def __init__(self) -> None:
        first, over_two = (2 - 2 * np.cos(step * _FREQUENCY) for step in (1, 2))
        self._squared = (first[:, None] + first[None, :]) ** 2
        self._ratio = (over_two[:, None] + over_two[None, :]) ** 2 / self._squared
        self.whole = float(self._ratio.mean())
        self._log = np.linspace(-12.0, 18.0, 121)
        x = np.exp(self._log)[:, None, None]
        self._log_determined = np.log((self._ratio * x / (x + self._squared)).mean(axis=(1, 2)))
        self._log_spread = np.log((1 / (x + self._squared)).mean(axis=(1, 2)))

    def determined(self, x: FloatArray, y: FloatArray | None = None) -> FloatArray:
        """Return what the data determine of the curvature over two pixels, in units of tau^2."""
        if y is None:
            return np.asarray(np.exp(np.interp(np.log(x), self._log, self._log_determined)), np.float64)
        return self._with_slopes(0, x, y)

    def spread(self, x: FloatArray, y: FloatArray | None = None) -> FloatArray:
        """Return the variance of a height, in units of tau^2."""
        if y is None:
            return np.asarray(np.exp(np.interp(np.log(x), self._log, self._log_spread)), np.float64)
        return self._with_slopes(1, x, y)

    def half_passing(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the period in px of the wave that passes with half its height."""
        return self._with_slopes(2, x, y)

    def _with_slopes(self, which: int, x: FloatArray, y: FloatArray) -> FloatArray:
        places = [
            (np.log(np.clip(value, np.exp(start), np.exp(stop))) - start) / _LOG_STEP
            for value, (start, stop) in ((x, _LOG_X), (y, _LOG_Y))
        ]
        at = np.stack([np.asarray(place, np.float64) for place in np.broadcast_arrays(*places)])
        found = map_coordinates(self._slope_tables[which], at.reshape(2, -1), order=1, mode="nearest")
        return np.asarray(np.exp(found.reshape(at.shape[1:])), np.float64)

    @cached_property
    def _slope_tables(self) -> FloatArray:
        """Return the logarithms of all three, (3, X, Y), over those of x and y."""
        log_x, log_y = (np.arange(start, stop + _LOG_STEP / 2, _LOG_STEP) for start, stop in (_LOG_X, _LOG_Y))
        told = response(_FREQUENCY)
        tables = np.empty((3, len(log_x), len(log_y)))
        # Waves along the diagonal, the finest of them included.
        frequency = np.geomspace(*_WAVES, _WAVE_COUNT)
        period = np.sqrt(2) * np.pi / frequency
        told_of_waves = np.diagonal(response(frequency))
        squared_of_waves = (4 - 4 * np.cos(frequency)) ** 2
        for i, x in enumerate(np.exp(log_x)):
            data = x + np.exp(log_y)[:, None, None] * told
            open_share = 1 / (data + self._squared)
            tables[0, i] = np.log((self._ratio * data * open_share).mean(axis=(1, 2)))
            tables[1, i] = np.log(open_share.mean(axis=(1, 2)))
            weight = x + np.exp(log_y)[:, None] * told_of_waves
            passing = weight / (weight + squared_of_waves)
            tables[2, i] = [np.log(_finest_passing(share, period)) for share in passing]
        return tables


def _finest_passing(share: FloatArray, period: FloatArray) -> float:
    """Return down to which of falling periods (N,) at least half is held throughout."""
    lost = np.flatnonzero(share < 0.5)
    if len(lost) == 0:
        return float(period[-1])
    first = int(lost[0])
    if first == 0:
        return float(period[0])
    return float(np.interp(0.5, share[[first, first - 1]], period[[first, first - 1]]))


@cache
def lattice_table() -> LatticeTable:
    """Return the table, the same one each time."""
    return LatticeTable()


@dataclass(frozen=True)
class Smoothness:
    """The prior's variance tau^2 (H, W) of a second difference, and the weight (H, W) of each place in it."""

    variance: FloatArray
    weight: FloatArray


def smoothness_by_evidence(
    height: FloatArray,
    stiffness: FloatArray,
    cut: tuple[FloatArray, FloatArray, FloatArray],
    before: Smoothness,
    table: LatticeTable,
    slopes: FloatArray | None = None,
) -> Smoothness:
    """Take one step of MacKay's fixed point; places of much more curvature than their neighbours weigh less.

    `slopes` (H, W) is how precisely slopes are told, where they are.
    """
    xx, yy, xy = _cut_over_two(cut)
    differences = second_differences(height, 2)
    curvature = sum(w * d * d for w, d in zip((xx, yy, 2 * xy), differences, strict=True))
    counted = (xx + yy + 2 * xy) / 4
    x = np.clip(_local(stiffness, counted, _STIFFNESS_PX) * before.variance, 1e-5, 1e7)
    determined = table.determined(x, None if slopes is None else slopes * before.variance)
    left_open = (table.whole - determined) * before.variance
    here = _local(np.asarray(curvature), counted, 1.0) / np.maximum(_local(counted, None, 1.0), 1e-3)
    weight = (_STUDENT + 1) / (_STUDENT + (here + left_open) / (table.whole * before.variance))
    mean = _local(weight * np.asarray(curvature), None, _LOCAL_PX) / np.maximum(_local(counted, None, _LOCAL_PX), 1e-3)
    ratio = mean / np.maximum(determined, 0.02 * table.whole) / before.variance
    variance = before.variance * np.clip(ratio, 0.5, 2.0) ** _HASTE
    return Smoothness(np.clip(variance, 1e-6, 1e4), weight)


def height_variance(
    stiffness: FloatArray, known: BoolArray, prior: Smoothness, table: LatticeTable, slopes: FloatArray | None = None
) -> FloatArray:
    """Return the posterior variance (H, W) of the heights under data and prior."""
    variance = prior.variance / prior.weight
    x = np.clip(_local(stiffness, known.astype(np.float64), _STIFFNESS_PX) * variance, 1e-5, 1e7)
    return variance * table.spread(x, None if slopes is None else slopes * variance)


def passing_period(
    stiffness: FloatArray, known: BoolArray, prior: Smoothness, table: LatticeTable, slopes: FloatArray
) -> FloatArray:
    """Return the period (H, W) in px of the wave that passes with half its height, where slopes are told."""
    variance = prior.variance / prior.weight
    x = np.clip(_local(stiffness, known.astype(np.float64), _STIFFNESS_PX) * variance, 1e-5, 1e7)
    return table.half_passing(x, slopes * variance)


def averaging_width(stiffness: FloatArray, known: BoolArray, prior: Smoothness, table: LatticeTable) -> FloatArray:
    """Return the sigma (H, W) px of the Gaussian window that averages as many pixels as the posterior does."""
    local = np.maximum(_local(stiffness, known.astype(np.float64), _STIFFNESS_PX), 1e-12)
    width: FloatArray = np.sqrt(1 / (local * height_variance(stiffness, known, prior, table)) / (4 * np.pi))
    return width


def most_probable(
    height: FloatArray,
    data: DataTerm,
    cut: tuple[FloatArray, FloatArray, FloatArray],
    prior: Smoothness,
    terms: Sequence[SlopeTerm] = (),
    *,
    steps: int = _STEPS,
    levels: int = _LEVELS,
) -> FloatArray:
    """Solve (k + D' W D / tau^2) h = k height + pull by conjugate gradients from `height` on.

    Each of the terms adds its own product to the left and its pull to the right.

    The change is solved for, so single precision is enough; sums are in double precision and in one order. `levels`
    coarser grids precondition it; with none, steps that are few leave what is smooth over more pixels as it is.
    """
    wxx, wyy, wxy = ((w * prior.weight / prior.variance).astype(np.float32) for w in cut)
    stiffness = data.stiffness.astype(np.float32)
    offset = float(height.mean())
    product = np.empty(height.shape, np.float32)
    _apply((height - offset).astype(np.float32), np.zeros_like(stiffness), wxx, wyy, wxy, product)
    residual = data.pull.astype(np.float32) - product
    diagonal = stiffness + _prior_diagonal(wxx, wyy, wxy)
    if terms:
        told = np.float32(response(_FREQUENCY).mean())
        for term in terms:
            residual += term.pull()
            diagonal += told * term.slope_precision()
    inverse = inverse_diagonals(stiffness, (wxx, wyy, wxy), diagonal, levels)
    change = np.zeros_like(residual)
    direction = answer(residual, inverse)
    power = start = _dot(residual, direction)
    for _ in range(steps):
        if power <= _TOLERANCE**2 * start or power == 0:
            break
        curvature = _apply(direction, stiffness, wxx, wyy, wxy, product)
        for term in terms:
            told_by = term.product(direction)
            curvature += _dot(direction, told_by)
            product += told_by
        step = power / curvature
        _descend(np.float32(step), direction, product, change, residual)
        answered = answer(residual, inverse)
        power, last = _dot(residual, answered), power
        _turn(np.float32(power / last), answered, direction)
    return height + change


def _local(values: FloatArray, weight: FloatArray | None, sigma_px: float) -> FloatArray:
    """Return the Gaussian mean of values (H, W), of those with weight only where one is given."""
    share = np.ones_like(values) if weight is None else weight
    total = gaussian_window((values * share).astype(np.float32), sigma_px)
    return np.asarray(total / np.maximum(gaussian_window(share.astype(np.float32), sigma_px), 1e-6), np.float64)


def _prior_diagonal(wxx: Plane, wyy: Plane, wxy: Plane) -> Plane:
    diagonal = 4 * (wxx + wyy)
    diagonal[:, :-1] += wxx[:, 1:]
    diagonal[:, 1:] += wxx[:, :-1]
    diagonal[:-1] += wyy[1:]
    diagonal[1:] += wyy[:-1]
    corner = 2 * wxy[:-1, :-1]
    for rows in (slice(None, -1), slice(1, None)):
        for cols in (slice(None, -1), slice(1, None)):
            diagonal[rows, cols] += corner
    return diagonal


@njit(cache=True, nogil=True, fastmath=True)
def _apply(h: Plane, k: Plane, wxx: Plane, wyy: Plane, wxy: Plane, out: Plane) -> float:  # pragma: no cover - compiled
    """Compute out = (k + D' W D) h and return h . out; the weights of differences that would leave the grid are 0."""
    rows, cols = h.shape
    zero, two = np.float32(0), np.float32(2)
    # Weighted differences of a row; those of the next and the last two rows, with a zero before and after.
    along = np.zeros(cols + 2, np.float32)
    above, middle, below = np.zeros(cols, np.float32), np.zeros(cols, np.float32), np.zeros(cols, np.float32)
    corner_above, corner = np.zeros(cols + 1, np.float32), np.zeros(cols + 1, np.float32)
    total = 0.0
    for r in range(rows):
        own, result = h[r], out[r]
        for c in range(1, cols - 1):
            along[c + 1] = wxx[r, c] * (own[c - 1] - two * own[c] + own[c + 1])
        above, middle, below = middle, below, above
        corner_above, corner = corner, corner_above
        if r + 2 < rows:
            next_row, next_but_one = h[r + 1], h[r + 2]
            for c in range(cols):
                below[c] = wyy[r + 1, c] * (own[c] - two * next_row[c] + next_but_one[c])
        else:
            below[:] = zero
        if r + 1 < rows:
            next_row = h[r + 1]
            for c in range(cols - 1):
                corner[c + 1] = two * wxy[r, c] * (own[c] - own[c + 1] - next_row[c] + next_row[c + 1])
        else:
            corner[:] = zero
        row_total = 0.0
        for c in range(cols):
            value = k[r, c] * own[c] + along[c] - two * along[c + 1] + along[c + 2]
            value += above[c] - two * middle[c] + below[c]
            value += corner[c + 1] - corner[c] - corner_above[c + 1] + corner_above[c]
            result[c] = value
            row_total += own[c] * value
        total += row_total
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _dot(one: Plane, other: Plane) -> float:  # pragma: no cover - compiled
    total = 0.0
    for r in range(len(one)):
        row_total = 0.0
        for c in range(one.shape[1]):
            row_total += one[r, c] * other[r, c]
        total += row_total
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _descend(
    step: np.float32, direction: Plane, product: Plane, change: Plane, residual: Plane
) -> None:  # pragma: no cover - compiled
    """Go along the direction, in place."""
    for r in range(len(change)):
        for c in range(change.shape[1]):
            change[r, c] += step * direction[r, c]
            residual[r, c] -= step * product[r, c]


@njit(cache=True, nogil=True, fastmath=True)
def _turn(ratio: np.float32, answered: Plane, direction: Plane) -> None:  # pragma: no cover - compiled
    for r in range(len(direction)):
        for c in range(direction.shape[1]):
            direction[r, c] = answered[r, c] + ratio * direction[r, c]
