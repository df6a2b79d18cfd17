"""The search over minimal samples that a contrario and plain RANSAC share.

Samples are drawn in batches from the generator. Every model of a batch is compared with the best of the batches
before it, and of equal ones the first wins: the result does not depend on the number of threads. Each new best model
is refined at once by least squares over its inliers, and at the end a tenth as many samples again are drawn among
the inliers (Chum et al. 2003, doi:10.1007/978-3-540-45243-0_31).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from semscape.errors import TooFewMatchesError
from semscape.robust.models import Frame, Model, Shape
from semscape.types import BoolArray, FloatArray, IntArray

_MIN_TRIALS = 100
_MIN_LOCAL_TRIALS = 100
_FIRST_BATCH, _LARGEST_BATCH = 16, 256
_REFITS = 10
# Least squares over the very inliers of a model tends to find them again; nearer and farther ones lead out of that.
_REACHES = (1.0, 0.7, 1.5)
_IRRATIONAL = np.sqrt([2.0, 3.0, 5.0, 7.0])


@dataclass(frozen=True)
class RobustFit:
    """A model with its inliers among M matches.

    `matrix` (3, 3), of Frobenius norm 1, is for homogeneous px points: x2^T F x1 = 0, or x2 ~ H x1 for a homography;
    `inliers` (M,) bool are the matches whose `residual_px` (M,) is at most `threshold_px`; the model is meaningful
    when `log10_nfa` < 0, which is NaN where the threshold was given.
    """

    kind: str
    matrix: FloatArray
    inliers: BoolArray
    residual_px: FloatArray
    threshold_px: float
    log10_nfa: float
    n_trials: int


class Score(Protocol):
    """Says how bad models are; the least value is the best."""

    def of_models(
        self, matrices: FloatArray, count: IntArray, best: float, values: FloatArray, thresholds_px: FloatArray
    ) -> None:
        """Write the value and the inlier threshold (B, S) of models (B, S, 3, 3), inf for all worse than `best`."""

    def is_evidence(self, value: float) -> bool:
        """Tell whether a model of this value is worth a closer look."""


@dataclass(frozen=True)
class Candidate:
    """A model (3, 3) in the frame, its value, and the threshold of its inliers."""

    matrix: FloatArray
    value: float
    threshold_px: float


@dataclass(frozen=True)
class DistinctMatches:
    """Matches in the frame: `w` (n, 4) those that can be evidence, finite, each once, in random order.

    `points` (4, n) are the same, a coordinate a row; `all_points` (4, M) are the matches as they were given.
    """

    w: FloatArray
    points: FloatArray
    all_points: FloatArray
    frame: Frame


def distinct_matches(
    model: Model, x1: FloatArray, x2: FloatArray, shapes: tuple[Shape, Shape], *, rng: np.random.Generator
) -> DistinctMatches:
    """Check matches (M, 2) and (M, 2) and put the distinct ones in random order.

    A match that is listed twice (a keypoint with two orientations) is one piece of evidence, not two.

    Raises
    ------
    ValueError
        For arrays of other shapes.
    TooFewMatchesError
        With fewer distinct matches than a minimal sample and one more.
    """
    if x1.ndim != 2 or x1.shape[1] != 2 or x1.shape != x2.shape:
        raise ValueError(f"matches are two (M, 2) arrays, got {x1.shape} and {x2.shape}")
    frame = Frame.of(shapes)
    w = frame.normalized(x1, x2)
    all_points = np.ascontiguousarray(w.T)
    # Equal rows have equal keys, so they are neighbours in the order of the keys. What is not finite has none.
    key = sum(factor * row for factor, row in zip(_IRRATIONAL, all_points, strict=True))
    order = np.argsort(key, kind="stable")
    order = order[np.isfinite(key[order])]
    alike = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    repeated = alike[(w[order[alike]] == w[order[alike + 1]]).all(axis=1)] + 1
    distinct = np.sort(np.delete(order, repeated))
    if len(distinct) <= model.sample_size:
        raise TooFewMatchesError(
            f"{len(x1)} matches, {len(distinct)} of them distinct and finite: a model of kind {model.kind!r} needs at "
            f"least {model.sample_size + 1}"
        )
    w = w.take(distinct[rng.permutation(len(distinct))], axis=0)
    return DistinctMatches(w, np.ascontiguousarray(w.T), all_points, frame)


def search(
    model: Model,
    matches: DistinctMatches,
    score: Score,
    *,
    rng: np.random.Generator,
    max_trials: int,
    failure_probability: float,
    workers: int,
) -> tuple[Candidate, int]:
    """Return the best model and the number of samples drawn.

    Sampling stops once a sample of inliers alone has been drawn but for `failure_probability`.

    Raises
    ------
    TooFewMatchesError
        When every sample is degenerate.
    """
    n = len(matches.w)
    best = Candidate(np.zeros((3, 3)), math.inf, 0.0)
    done, batch = 0, _FIRST_BATCH
    needed: float = max_trials
    with ThreadPoolExecutor(workers) if workers > 1 else nullcontext() as pool:
        run = pool.map if pool else map
        while done < needed:
            samples = _draw(rng, n, model.sample_size, int(min(batch, needed - done)))
            candidate = _best_of(model, matches, score, samples, best, run, workers)
            done += len(samples)
            batch = min(2 * batch, _LARGEST_BATCH)
            if candidate is not best and score.is_evidence(candidate.value):
                best = _refined(model, matches, score, candidate)
                share = float((_residuals(model, matches, best) <= best.threshold_px).mean())
                needed = min(needed, max(_MIN_TRIALS, _trials_for(share**model.sample_size, failure_probability)))
            else:
                best = candidate
        if not math.isfinite(best.value):
            raise TooFewMatchesError(f"all samples of {n} matches are degenerate: the matches lie on a line or repeat")
        inliers = np.flatnonzero(_residuals(model, matches, best) <= best.threshold_px)
        if score.is_evidence(best.value) and len(inliers) > model.sample_size + 1:
            local = inliers[_draw(rng, len(inliers), model.sample_size, max(done // 10, _MIN_LOCAL_TRIALS))]
            best = _best_of(model, matches, score, local, best, run, workers)
            best = _settled(model, matches, score, _refined(model, matches, score, best, _REACHES))
            done += len(local)
    return best, done


def _residuals(model: Model, matches: DistinctMatches, candidate: Candidate) -> FloatArray:
    return model.residuals_px(candidate.matrix, matches.points, matches.frame)


def _best_of(
    model: Model,
    matches: DistinctMatches,
    score: Score,
    samples: IntArray,
    best: Candidate,
    run: Callable[..., Iterable[Any]],
    workers: int,
) -> Candidate:
    """Return the best model of all samples, or `best` itself where none is better."""
    values = np.full((len(samples), model.max_solutions), math.inf)
    thresholds = np.zeros_like(values)
    matrices = np.empty((*values.shape, 3, 3))

    def evaluate(part: slice) -> None:
        matrices[part], count = model.solve_samples(matches.w, samples[part], matches.frame)
        score.of_models(matrices[part], count, best.value, values[part], thresholds[part])

    step = -(-len(samples) // workers)
    list(run(evaluate, [slice(start, start + step) for start in range(0, len(samples), step)]))
    least = np.unravel_index(np.argmin(values), values.shape)
    if not values[least] < best.value:
        return best
    return Candidate(matrices[least].copy(), float(values[least]), float(thresholds[least]))


def _refined(
    model: Model, matches: DistinctMatches, score: Score, candidate: Candidate, reaches: tuple[float, ...] = (1.0,)
) -> Candidate:
    """Alternate least squares on the inliers and new inliers, as long as the value falls.

    Inliers are those within `reaches` times the threshold, the first of these that makes the value fall.
    """
    for _ in range(_REFITS):
        residual = _residuals(model, matches, candidate)
        for reach in reaches:
            better = _fitted(model, matches, score, candidate, residual <= reach * candidate.threshold_px)
            if better is not candidate:
                break
        if better is candidate:
            break
        candidate = better
    return candidate


def _settled(model: Model, matches: DistinctMatches, score: Score, candidate: Candidate) -> Candidate:
    """Fit the inliers once more by the model's own last fit, and choose them anew, whatever the value.

    Of all models the best is the one that has gathered most matches by chance; this one has not been chosen so.
    """
    if model.settle is None:
        return candidate
    inliers = np.flatnonzero(_residuals(model, matches, candidate) <= candidate.threshold_px)
    matrix = model.settle(matches.w.take(inliers, axis=0))
    if matrix is None:
        return candidate
    value, threshold = _scored(score, matrix, math.inf)
    return Candidate(matrix, value, threshold) if score.is_evidence(value) else candidate


def _scored(score: Score, matrix: FloatArray, bar: float) -> tuple[float, float]:
    """Return the value and the threshold of one model, the value infinite where it is worse than `bar`."""
    value, threshold = np.empty((1, 1)), np.empty((1, 1))
    score.of_models(matrix[None, None], np.ones(1, dtype=np.int64), bar, value, threshold)
    return float(value[0, 0]), float(threshold[0, 0])


def _fitted(model: Model, matches: DistinctMatches, score: Score, candidate: Candidate, chosen: BoolArray) -> Candidate:
    """Return the least-squares model of the chosen matches where it is better, else the candidate itself."""
    matrix = model.fit_matches(matches.w.take(np.flatnonzero(chosen), axis=0), matches.frame)
    if matrix is None:
        return candidate
    value, threshold = _scored(score, matrix, candidate.value)
    return Candidate(matrix, value, threshold) if value < candidate.value else candidate


def _trials_for(good_share: float, failure_probability: float) -> float:
    """Return how many samples hold a good one but for the failure probability; `good_share` of all are good."""
    if failure_probability <= 0:
        return math.inf
    return (
        math.ceil(math.log(failure_probability) / math.log1p(-min(good_share, 1 - 1e-9)))
        if good_share > 0
        else math.inf
    )


def _draw(rng: np.random.Generator, n: int, size: int, n_samples: int) -> IntArray:
    """Draw (n_samples, size) indices below n, distinct within each row."""
    if n < 4 * size:  # rejection would take long
        return np.argsort(rng.random((n_samples, n)), axis=1)[:, :size]
    samples = rng.integers(0, n, (n_samples, size))
    while True:
        ordered = np.sort(samples, axis=1)
        repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
        if not repeated.any():
            return samples
        samples[repeated] = rng.integers(0, n, (int(repeated.sum()), size))
