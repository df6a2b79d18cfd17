"""A contrario RANSAC (Moisan & Stival 2004, doi:10.1023/B:VISI.0000013094.38752.54).

The number of false alarms (NFA) of a model with its k best matches is the expected number of equally good
models among matches thrown uniformly over the images. The model, and with it k and the inlier threshold,
is the one of least NFA: no threshold is given.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.special import gammaln

from semscape.errors import TooFewMatchesError
from semscape.robust.affine_epipolar import (
    SAMPLE_SIZE,
    epipolar_distance_px,
    fit_hyperplane,
    fundamental_matrix,
    hyperplane_of_four,
)
from semscape.types import FloatArray, IntArray, TwoViewGeometry

_FAILURE_PROBABILITY = 1e-6
_MIN_TRIALS = 100
_REFITS = 10
# Below a hundredth of a pixel residuals say how matches were rounded, not how good a model is.
_LEAST_RESIDUAL_PX = 0.01


def ac_ransac(
    pair: tuple[int, int],
    xy1: FloatArray,
    xy2: FloatArray,
    shape: tuple[int, int],
    *,
    max_trials: int,
    rng: np.random.Generator,
) -> TwoViewGeometry:
    """Estimate the affine epipolar geometry of a pair and its inliers, without a threshold.

    Parameters
    ----------
    pair : (int, int)
        View indices i1 < i2.
    xy1, xy2 : (M, 2) float arrays
        Matched points in px.
    shape : (int, int)
        Height and width of the images in px.
    max_trials : int
        Largest number of random samples; fewer are drawn once more cannot help.
    rng : numpy.random.Generator

    Returns
    -------
    TwoViewGeometry
        `kind` is "affine"; the model is meaningful when `log10_nfa` < 0.

    Raises
    ------
    TooFewMatchesError
        With fewer than five matches, or when every sample is degenerate.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> xy1 = rng.uniform(0, 500, (200, 2))
    >>> xy2 = xy1 + np.column_stack([rng.uniform(-9, 9, 200), rng.normal(0, 0.3, 200)])
    >>> xy2[:80] = rng.uniform(0, 500, (80, 2))
    >>> geometry = ac_ransac((0, 1), xy1, xy2, (500, 500), max_trials=2000, rng=rng)
    >>> bool(geometry.inliers[80:].mean() > 0.9), 0.3 < geometry.threshold_px < 2
    (True, True)
    """
    n = len(xy1)
    if n <= SAMPLE_SIZE:
        raise TooFewMatchesError(f"{n} matches, an epipolar geometry needs at least {SAMPLE_SIZE + 1}")
    height, width = shape
    w = np.ascontiguousarray(np.column_stack([xy1, xy2]), dtype=np.float64)
    # Scaled to about unit size so that degenerate samples are told by absolute limits.
    unit = float(max(height, width))
    scaled = w / unit
    log_alpha0 = math.log10(2 * math.hypot(height, width) / (height * width))
    table = log10_combinations(n, SAMPLE_SIZE)

    samples = _draw_samples(rng, n, max_trials)
    best, log10_nfa, n_trials = _search(scaled, samples, unit, table, log_alpha0, n, True)
    if not np.isfinite(log10_nfa):
        raise TooFewMatchesError(f"all samples of {n} matches are degenerate: the matches lie on a line or repeat")
    if log10_nfa < 0:
        inliers = np.flatnonzero(_explained(best, scaled, unit, table, log_alpha0)[0])
        local = (
            inliers[_draw_samples(rng, len(inliers), max(max_trials // 10, 20))] if len(inliers) > 8 else samples[:1]
        )
        candidate, candidate_nfa, extra = _search(scaled, local, unit, table, log_alpha0, n, False)
        n_trials += extra
        if candidate_nfa < log10_nfa:
            best, log10_nfa = candidate, candidate_nfa
        best = _refit(best, scaled, unit, table, log_alpha0)
    inlier_mask, residual, threshold, log10_nfa = _explained(best, scaled, unit, table, log_alpha0)
    hyperplane = np.append(best[:4], best[4] * unit)
    return TwoViewGeometry(
        pair, "affine", fundamental_matrix(hyperplane), inlier_mask, residual, threshold, log10_nfa, n_trials
    )


def log10_combinations(n: int, sample_size: int) -> FloatArray:
    """Return log10 of (n - Ns) C(n, k) C(k, Ns) for k = 0 .. n, infinite for k <= Ns."""
    k = np.arange(n + 1, dtype=np.float64)
    table = np.full(n + 1, np.inf)
    big = k[sample_size + 1 :]
    log_n_choose_k = gammaln(n + 1) - gammaln(big + 1) - gammaln(n - big + 1)
    log_k_choose_s = gammaln(big + 1) - gammaln(sample_size + 1) - gammaln(big - sample_size + 1)
    table[sample_size + 1 :] = (math.log(n - sample_size) + log_n_choose_k + log_k_choose_s) / math.log(10)
    return table


def _explained(
    hyperplane: FloatArray, w: FloatArray, unit: float, table: FloatArray, log_alpha0: float
) -> tuple[np.ndarray, FloatArray, float, float]:
    """Return inliers (M,), residuals (M,) px, threshold px and log10 NFA of one model."""
    residual = epipolar_distance_px(hyperplane, w) * unit
    log10_nfa, k = _least_nfa(np.sort(residual), table, log_alpha0)
    threshold = float(np.partition(residual, k - 1)[k - 1])
    return residual <= threshold, residual, threshold, float(log10_nfa)


def _refit(hyperplane: FloatArray, w: FloatArray, unit: float, table: FloatArray, log_alpha0: float) -> FloatArray:
    """Alternate total least squares on the inliers and new inliers, as long as the NFA falls."""
    inliers, _, _, log10_nfa = _explained(hyperplane, w, unit, table, log_alpha0)
    for _ in range(_REFITS):
        candidate = fit_hyperplane(w[inliers])
        new_inliers, _, _, candidate_nfa = _explained(candidate, w, unit, table, log_alpha0)
        if candidate_nfa >= log10_nfa:
            break
        hyperplane, inliers, log10_nfa = candidate, new_inliers, candidate_nfa
    return hyperplane


def _draw_samples(rng: np.random.Generator, n: int, n_trials: int) -> IntArray:
    """Draw (n_trials, 4) indices, distinct within each row."""
    samples = rng.integers(0, n, (n_trials, SAMPLE_SIZE))
    while True:
        ordered = np.sort(samples, axis=1)
        repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
        if not repeated.any():
            return samples
        samples[repeated] = rng.integers(0, n, (int(repeated.sum()), SAMPLE_SIZE))


@njit(cache=True, nogil=True)
def _least_nfa(ordered_residual: FloatArray, table: FloatArray, log_alpha0: float) -> tuple[float, int]:
    best, best_k = np.inf, SAMPLE_SIZE + 1
    for k in range(SAMPLE_SIZE + 1, len(ordered_residual) + 1):
        log_alpha = log_alpha0 + math.log10(max(ordered_residual[k - 1], _LEAST_RESIDUAL_PX))
        value = table[k] + (k - SAMPLE_SIZE) * min(log_alpha, 0.0)
        if value < best:
            best, best_k = value, k
    return best, best_k


@njit(cache=True, nogil=True)
def _search(
    w: FloatArray,
    samples: IntArray,
    unit: float,
    table: FloatArray,
    log_alpha0: float,
    n: int,
    may_stop: bool,
) -> tuple[FloatArray, float, int]:
    """Return the hyperplane of least NFA among the samples, its log10 NFA and the number of trials made."""
    best = np.zeros(5)
    best_nfa = np.inf
    hyperplane = np.empty(5)
    residual = np.empty(n)
    needed = len(samples)
    trial = 0
    while trial < needed:
        sample = samples[trial]
        trial += 1
        if not hyperplane_of_four(w, sample[0], sample[1], sample[2], sample[3], hyperplane):
            continue
        weaker = np.sqrt(min(hyperplane[0] ** 2 + hyperplane[1] ** 2, hyperplane[2] ** 2 + hyperplane[3] ** 2))
        for j in range(n):
            value = (
                hyperplane[0] * w[j, 0]
                + hyperplane[1] * w[j, 1]
                + hyperplane[2] * w[j, 2]
                + hyperplane[3] * w[j, 3]
                + hyperplane[4]
            )
            residual[j] = abs(value) / weaker * unit
        nfa, k = _least_nfa(np.sort(residual), table, log_alpha0)
        if nfa < best_nfa:
            best_nfa = nfa
            best[:] = hyperplane
            if may_stop and nfa < 0:
                all_inliers = min((k / n) ** SAMPLE_SIZE, 1 - 1e-9)
                enough = int(math.log(_FAILURE_PROBABILITY) / math.log(1 - all_inliers)) + 1
                needed = min(len(samples), max(_MIN_TRIALS, enough))
    return best, best_nfa, trial
