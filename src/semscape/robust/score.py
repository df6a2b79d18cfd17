"""The number of false alarms (NFA) of many models, compiled: residuals, their histogram, early rejection.

Residuals are squared and in float32, whose bits, cut short, are the bin of a histogram over their logarithm (16 bins
for each doubling of the residual). The NFA at the upper edges of the bins bounds the exact one from above, without a
sort. A model is given up on the first hundreds of matches, which stand in random order, when even the most inliers
that they leave likely (three sigmas) could not bring its NFA below that of the best model.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from semscape.compiled import njit
from semscape.types import FloatArray, IntArray

Points = NDArray[Any]

# Kinds of residual; the two first are the larger distance to the two epipolar lines, the last that to the two points.
AFFINE_LINE, LINE, POINT = 0, 1, 2
REJECTED = np.inf

# Below a hundredth of a pixel residuals say how matches were rounded, not how good a model is.
LEAST_RESIDUAL_PX = 0.01

_SHIFT = 20
_CHUNK = 256
_SIGMAS = 3.0


def log10_combinations(n: int, sample_size: int, max_solutions: int) -> FloatArray:
    """Return log10 of S (n - Ns) C(n, k) C(k, Ns) for k = 0 .. n, infinite for k <= Ns.

    Examples
    --------
    >>> float(10 ** log10_combinations(6, 4, 1)[5])  # (6 - 4) C(6, 5) C(5, 4)
    60.0
    """
    log_factorial = gammaln(np.arange(1.0, n + 2))
    big = log_factorial[sample_size + 1 :]
    log_n_choose_k = log_factorial[n] - big - log_factorial[: n - sample_size][::-1]
    log_k_choose_s = big - log_factorial[sample_size] - log_factorial[1 : n + 1 - sample_size]
    table = np.full(n + 1, np.inf)
    outcomes = math.log(max_solutions * (n - sample_size))
    table[sample_size + 1 :] = (outcomes + log_n_choose_k + log_k_choose_s) / math.log(10)
    return table


def histogram_bins(log_alpha0: float, dimension: int, unit_px: float) -> tuple[int, FloatArray, FloatArray]:
    """Return the first bin's number, and log10 of the chance of a residual (B,) and squared residual (B,) at the edges.

    Residuals are in units of `unit_px`; the last bin holds all whose chance is one.
    """
    least = np.float32((LEAST_RESIDUAL_PX / unit_px) ** 2)
    most = np.float32((10.0 ** (-log_alpha0 / dimension) / unit_px) ** 2)
    first, last = (int(value.view(np.int32)) >> _SHIFT for value in (least, most))
    upper = ((np.arange(first, last + 2) + 1) << _SHIFT).astype(np.int32).view(np.float32).astype(np.float64)
    log_alpha = np.minimum(log_alpha0 + dimension * (0.5 * np.log10(upper) + math.log10(unit_px)), 0.0)
    log_alpha[-1] = 0.0
    upper[-1] = np.inf
    return first, log_alpha, upper


def checkpoints(n: int) -> tuple[IntArray, IntArray]:
    """Return after how many of n matches a model may be given up (C,), and the most inliers likely then (C, m + 1).

    Row c, column i: the upper limit of Wilson's interval for n matches of which i of the first m are inliers.
    """
    stops = np.array([m for m in (256, 1024, 4096) if 2 * m <= n], dtype=np.int64)
    likely = np.zeros((len(stops), int(stops[-1]) + 1 if len(stops) else 1), dtype=np.int64)
    for row, m in zip(likely, stops, strict=True):
        share = np.arange(m + 1) / m
        spread = np.sqrt(share * (1 - share) / m + _SIGMAS**2 / (4 * m * m))
        upper = (share + _SIGMAS**2 / (2 * m) + _SIGMAS * spread) / (1 + _SIGMAS**2 / m)
        row[: m + 1] = np.ceil(n * np.minimum(upper, 1.0))
    return stops, likely


def least_nfa(
    residual_px: FloatArray, table: FloatArray, log_alpha0: float, sample_size: int, dimension: int
) -> tuple[float, float]:
    """Return the exact log10 NFA of a model, and the residual at which it is reached: the threshold in px."""
    ordered = np.sort(residual_px)
    log_alpha = log_alpha0 + dimension * np.log10(np.maximum(ordered, LEAST_RESIDUAL_PX))
    k = np.arange(1, len(ordered) + 1)
    values = table[1:] + (k - sample_size) * np.minimum(log_alpha, 0.0)
    best = int(np.argmin(values))
    return float(values[best]), float(ordered[best])


@njit(cache=True, nogil=True)
def score_models(
    residual: int,
    sample_size: int,
    points: Points,
    matrices: FloatArray,
    count: IntArray,
    table: FloatArray,
    first_bin: int,
    log_alpha: FloatArray,
    stops: IntArray,
    likely: IntArray,
    bar: float,
    log10_nfa: FloatArray,
    edge: IntArray,
) -> None:
    """Write the log10 NFA (B, S) of each model (B, S, 3, 3), `REJECTED` above `bar`, and the bin it is reached in.

    `points` is (4, n) in random order; `count` (B,) the number of models in each row.
    """
    n = points.shape[1]
    squared = np.empty(_CHUNK, np.float32)
    bits = squared.view(np.int32)
    bins = np.empty(_CHUNK, np.int32)
    last_bin = len(log_alpha) - 1
    histogram = np.empty((2, last_bin + 1), np.int32)
    for trial in range(len(count)):
        log10_nfa[trial] = REJECTED
        for s in range(count[trial]):
            matrix = matrices[trial, s].astype(np.float32)
            if not np.isfinite(matrix).all():
                continue
            histogram[:] = 0
            check = 0
            given_up = False
            for start in range(0, n, _CHUNK):
                size = min(_CHUNK, n - start)
                squared_residuals(residual, matrix, points, start, size, squared)
                for i in range(size):
                    bins[i] = min(max((bits[i] >> _SHIFT) - first_bin, 0), last_bin)
                # Two histograms: an increment need not wait for the one before it.
                for i in range(0, size - 1, 2):
                    histogram[0, bins[i]] += 1
                    histogram[1, bins[i + 1]] += 1
                if size % 2:
                    histogram[0, bins[size - 1]] += 1
                if check < len(stops) and start + size == stops[check]:
                    if _optimum(histogram, table, log_alpha, sample_size, likely[check], True)[0] > bar:
                        given_up = True
                        break
                    check += 1
            if not given_up:
                log10_nfa[trial, s], edge[trial, s] = _optimum(
                    histogram, table, log_alpha, sample_size, likely[0], False
                )


@njit(cache=True, nogil=True)
def _optimum(
    histogram: NDArray[np.int32],
    table: FloatArray,
    log_alpha: FloatArray,
    sample_size: int,
    likely: IntArray,
    translate: bool,
) -> tuple[float, int]:
    """Return the least log10 NFA over the bins and its bin; counts of a part are first turned into likely totals."""
    best, best_bin = np.inf, 0
    cumulated = 0
    n = len(table) - 1
    for b in range(len(log_alpha)):
        added = histogram[0, b] + histogram[1, b]
        if added == 0 and (b > 0 or not translate):
            continue
        cumulated += added
        k = min(likely[cumulated], n) if translate else cumulated
        value = table[k] + (k - sample_size) * log_alpha[b]
        if value < best:
            best, best_bin = value, b
    return best, best_bin


@njit(cache=True, nogil=True)
def squared_residuals(residual: int, m: NDArray[Any], points: Points, start: int, size: int, out: NDArray[Any]) -> None:
    """Write the squared residuals of matches start .. start + size under one model, in single or double precision."""
    x1, y1 = points[0, start : start + size], points[1, start : start + size]
    x2, y2 = points[2, start : start + size], points[3, start : start + size]
    tiny = np.float32(1e-30)
    if residual == AFFINE_LINE:
        a, b, c, d, e = m[2, 0], m[2, 1], m[0, 2], m[1, 2], m[2, 2]
        inverse = np.float32(1.0) / (min(a * a + b * b, c * c + d * d) + tiny)
        for i in range(size):
            value = a * x1[i] + b * y1[i] + c * x2[i] + d * y2[i] + e
            out[i] = value * value * inverse
    elif residual == LINE:
        for i in range(size):
            a2, b2 = m[0, 0] * x1[i] + m[0, 1] * y1[i] + m[0, 2], m[1, 0] * x1[i] + m[1, 1] * y1[i] + m[1, 2]
            c2 = m[2, 0] * x1[i] + m[2, 1] * y1[i] + m[2, 2]
            a1, b1 = m[0, 0] * x2[i] + m[1, 0] * y2[i] + m[2, 0], m[0, 1] * x2[i] + m[1, 1] * y2[i] + m[2, 1]
            value = x2[i] * a2 + y2[i] * b2 + c2
            out[i] = value * value / (min(a1 * a1 + b1 * b1, a2 * a2 + b2 * b2) + tiny)
    else:
        g = _adjugate(m)
        for i in range(size):
            forward = _transfer(m, x1[i], y1[i], x2[i], y2[i], tiny)
            out[i] = max(forward, _transfer(g, x2[i], y2[i], x1[i], y1[i], tiny))


@njit(cache=True, nogil=True, inline="always")
def _transfer(m: Any, x: Any, y: Any, u: Any, v: Any, tiny: Any) -> Any:
    """Return the squared distance from (u, v) to where m takes (x, y)."""
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    inverse = w / (w * w + tiny)
    du = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) * inverse - u
    dv = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * inverse - v
    return du * du + dv * dv


@njit(cache=True, nogil=True)
def _adjugate(m: NDArray[Any]) -> NDArray[Any]:
    """Return the inverse up to its scale, which no transfer needs."""
    out = np.empty((3, 3), m.dtype)
    for i in range(3):
        for j in range(3):
            r, s, t, u = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            out[i, j] = m[r, t] * m[s, u] - m[r, u] * m[s, t]
    return out
