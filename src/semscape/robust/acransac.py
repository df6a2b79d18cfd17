"""A contrario RANSAC (Moisan & Stival 2004, doi:10.1023/B:VISI.0000013094.38752.54).

The number of false alarms (NFA) of a model with its k best matches is the expected number of equally good
models among matches thrown uniformly over the images. The model, and with it k and the inlier threshold,
is the one of least NFA: no threshold is given.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from semscape.robust.models import Model, Shape
from semscape.robust.score import (
    Points,
    checkpoints,
    histogram_bins,
    least_nfa,
    log10_combinations,
    score_models,
)
from semscape.robust.search import DistinctMatches, RobustFit, distinct_matches, search
from semscape.types import FloatArray, IntArray

FAILURE_PROBABILITY = 1e-6


def ac_ransac(
    model: Model,
    x1: FloatArray,
    x2: FloatArray,
    *,
    shapes: tuple[Shape, Shape],
    rng: np.random.Generator,
    max_trials: int,
    failure_probability: float = FAILURE_PROBABILITY,
    workers: int = 1,
) -> RobustFit:
    """Estimate a two-view model and its inliers, without a threshold.

    Parameters
    ----------
    model : Model
        `AFFINE`, `FUNDAMENTAL`, `HOMOGRAPHY` or `essential(K1, K2)` of `semscape.robust.models`.
    x1, x2 : (M, 2) float arrays
        Matched points in px. Matches with NaN are never inliers; one that is repeated counts once.
    shapes : ((int, int), (int, int))
        Height and width of the two images in px.
    rng : numpy.random.Generator
    max_trials : int
        Largest number of random samples; fewer are drawn once more cannot help.
    failure_probability : float
        Sampling stops when, at the inliers of the best model so far, the samples have missed one of inliers alone
        with this probability. 0 draws all `max_trials`.
    workers : int
        Threads over the samples; the result does not depend on it.

    Returns
    -------
    RobustFit
        Meaningful when `log10_nfa` < 0.

    Raises
    ------
    TooFewMatchesError
        With no more distinct matches than a minimal sample holds, or when every sample is degenerate.

    References
    ----------
    Moisan & Stival 2004, doi:10.1023/B:VISI.0000013094.38752.54; Moulon et al. 2012,
    doi:10.1007/978-3-642-37447-0_20

    Examples
    --------
    >>> from semscape.robust.models import AFFINE
    >>> rng = np.random.default_rng(0)
    >>> x1 = rng.uniform(0, 500, (200, 2))
    >>> x2 = x1 + np.column_stack([rng.uniform(-9, 9, 200), rng.normal(0, 0.3, 200)])
    >>> x2[:80] = rng.uniform(0, 500, (80, 2))
    >>> found = ac_ransac(AFFINE, x1, x2, shapes=((500, 500), (500, 500)), rng=rng, max_trials=2000)
    >>> bool(found.inliers[80:].mean() > 0.9), 0.3 < found.threshold_px < 2
    (True, True)
    """
    matches = distinct_matches(model, x1, x2, shapes, rng=rng)
    evidence = _Evidence.of(model, matches, model.log10_alpha0(shapes))
    best, n_trials = search(
        model,
        matches,
        evidence,
        rng=rng,
        max_trials=max_trials,
        failure_probability=failure_probability,
        workers=workers,
    )
    residual = model.residuals_px(best.matrix, matches.points, matches.frame)
    log10_nfa, threshold = least_nfa(residual, evidence.table, evidence.log_alpha0, model.sample_size, model.dimension)
    residual = model.residuals_px(best.matrix, matches.all_points, matches.frame)
    matrix = model.in_pixels(best.matrix, matches.frame)
    return RobustFit(model.kind, matrix, residual <= threshold, residual, threshold, log10_nfa, n_trials)


@dataclass(frozen=True)
class _Evidence:
    """The log10 NFA as the score of a search."""

    model: Model
    unit_px: float
    points: Points
    log_alpha0: float
    table: FloatArray
    first_bin: int
    log_alpha: FloatArray
    edge_px: FloatArray
    stops: IntArray
    likely: IntArray = field(repr=False)

    @classmethod
    def of(cls, model: Model, matches: DistinctMatches, log_alpha0: float) -> _Evidence:
        n, unit = len(matches.w), matches.frame.unit_px
        first_bin, log_alpha, upper = histogram_bins(log_alpha0, model.dimension, unit)
        return cls(
            model,
            unit,
            matches.points.astype(np.float32),
            log_alpha0,
            log10_combinations(n, model.sample_size, model.max_solutions),
            first_bin,
            log_alpha,
            np.sqrt(upper) * unit,
            *checkpoints(n),
        )

    def of_models(
        self, matrices: FloatArray, count: IntArray, best: float, values: FloatArray, thresholds_px: FloatArray
    ) -> None:
        # Once there is any model, one that cannot become meaningful need not be finished.
        bar = min(best, 0.0) if np.isfinite(best) else best
        edge = np.zeros(values.shape, dtype=np.int64)
        score_models(
            self.model.residual,
            self.model.sample_size,
            self.points,
            matrices,
            count,
            self.table,
            self.first_bin,
            self.log_alpha,
            self.stops,
            self.likely,
            bar,
            values,
            edge,
        )
        thresholds_px[:] = self.edge_px[edge]

    def is_evidence(self, value: float) -> bool:
        return value < 0
