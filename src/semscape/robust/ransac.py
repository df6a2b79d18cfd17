"""Plain RANSAC with a given threshold (Fischler & Bolles 1981, doi:10.1145/358669.358692), for comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from semscape.compiled import njit
from semscape.robust.acransac import FAILURE_PROBABILITY
from semscape.robust.models import Model, Shape
from semscape.robust.score import Points, squared_residuals
from semscape.robust.search import RobustFit, distinct_matches, search
from semscape.types import FloatArray, IntArray

_CHUNK = 256


def ransac(
    model: Model,
    x1: FloatArray,
    x2: FloatArray,
    *,
    threshold_px: float,
    shapes: tuple[Shape, Shape],
    rng: np.random.Generator,
    max_trials: int,
    failure_probability: float = FAILURE_PROBABILITY,
    workers: int = 1,
) -> RobustFit:
    """Estimate the two-view model with the most matches within a threshold.

    It differs from `ac_ransac` in nothing but the threshold: samples, refinement and stopping rule are the same.

    Parameters
    ----------
    threshold_px : float
        Largest residual of an inlier in px.
    model, x1, x2, shapes, rng, max_trials, failure_probability, workers
        As for `semscape.robust.acransac.ac_ransac`.

    Returns
    -------
    RobustFit
        Its `log10_nfa` is NaN: nothing says whether so many inliers could be chance.

    Raises
    ------
    TooFewMatchesError
        With no more distinct matches than a minimal sample holds, or when every sample is degenerate.

    Examples
    --------
    >>> from semscape.robust.models import AFFINE
    >>> rng = np.random.default_rng(0)
    >>> x1 = rng.uniform(0, 500, (100, 2))
    >>> x2 = x1 + np.column_stack([rng.uniform(-9, 9, 100), rng.normal(0, 0.3, 100)])
    >>> shapes = ((500, 500), (500, 500))
    >>> strict, wide = (
    ...     ransac(AFFINE, x1, x2, threshold_px=limit, shapes=shapes, rng=rng, max_trials=500) for limit in (0.1, 1.0)
    ... )
    >>> bool(strict.inliers.mean() < 0.5 < 0.9 < wide.inliers.mean())
    True
    """
    matches = distinct_matches(model, x1, x2, shapes, rng=rng)
    points = matches.points.astype(np.float32)
    best, n_trials = search(
        model,
        matches,
        _Inliers(model, points, threshold_px, matches.frame.unit_px),
        rng=rng,
        max_trials=max_trials,
        failure_probability=failure_probability,
        workers=workers,
    )
    residual = model.residuals_px(best.matrix, matches.all_points, matches.frame)
    matrix = model.in_pixels(best.matrix, matches.frame)
    return RobustFit(model.kind, matrix, residual <= threshold_px, residual, threshold_px, math.nan, n_trials)


@dataclass(frozen=True)
class _Inliers:
    """Minus the number of matches within the threshold as the score of a search."""

    model: Model
    points: Points
    threshold_px: float
    unit_px: float

    def of_models(
        self, matrices: FloatArray, count: IntArray, best: float, values: FloatArray, thresholds_px: FloatArray
    ) -> None:
        limit = (self.threshold_px / self.unit_px) ** 2
        _count_inliers(self.model.residual, self.points, matrices, count, limit, values)
        values[values >= best] = math.inf
        thresholds_px[:] = self.threshold_px

    def is_evidence(self, value: float) -> bool:
        return -value > self.model.sample_size


@njit(cache=True, nogil=True)
def _count_inliers(
    residual: int, points: Points, matrices: FloatArray, count: IntArray, limit: float, values: FloatArray
) -> None:
    """Write minus the number of inliers (B, S) of each model."""
    n = points.shape[1]
    squared = np.empty(_CHUNK, np.float32)
    for trial in range(len(count)):
        values[trial] = np.inf
        for s in range(count[trial]):
            matrix = matrices[trial, s].astype(np.float32)
            inliers = 0
            for start in range(0, n, _CHUNK):
                size = min(_CHUNK, n - start)
                squared_residuals(residual, matrix, points, start, size, squared)
                for i in range(size):
                    inliers += squared[i] <= limit
            values[trial, s] = -inliers
