"""A contrario RANSAC: it finds its own threshold, and says when there is nothing to find."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.errors import TooFewMatchesError
from semscape.geometry.cameras import camera_matrices
from semscape.robust.acransac import ac_ransac
from semscape.robust.affine_epipolar import epipolar_distance_px, fit_hyperplane
from semscape.types import Motion

SHAPE = (600, 800)


def pair_of_views(n: int, outliers: float, noise_px: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return matches of two views of random points under random tilts, and which of them are right."""
    rng = np.random.default_rng(seed)
    tilts = np.deg2rad([-rng.uniform(1, 5), rng.uniform(1, 5)])
    motion = Motion(
        rng.uniform(0, np.pi), tilts, np.deg2rad([0.1, -0.2]), np.array([1.0, 1.002]), np.zeros(2), np.zeros((2, 2))
    )
    points = np.column_stack([rng.uniform(-380, 380, n), rng.uniform(-280, 280, n), rng.uniform(-90, 90, n)])
    centre = np.array([399.5, 299.5])
    xy1, xy2 = (points @ matrix.T + centre + rng.normal(0, noise_px, (n, 2)) for matrix in camera_matrices(motion))
    right = np.ones(n, dtype=bool)
    right[: round(outliers * n)] = False
    xy2[~right] = rng.uniform(0, 1, (int((~right).sum()), 2)) * (SHAPE[1], SHAPE[0])
    return xy1, xy2, right


def estimate(xy1: np.ndarray, xy2: np.ndarray, seed: int = 0, max_trials: int = 2000):
    return ac_ransac((0, 1), xy1, xy2, SHAPE, max_trials=max_trials, rng=np.random.default_rng(seed))


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.45, 0.6])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_inliers_are_the_right_matches(outliers: float, seed: int) -> None:
    xy1, xy2, right = pair_of_views(500, outliers, 0.4, seed)
    geometry = estimate(xy1, xy2)
    recall = geometry.inliers[right].mean()
    precision = right[geometry.inliers].mean()
    assert recall > 0.92  # the threshold cuts the last tail of the noise
    # A wrong match lies within t of its line by chance with probability 2 t D / A: a perfect precision is impossible.
    by_chance = 2 * geometry.threshold_px * np.hypot(*SHAPE) / np.prod(SHAPE) * (~right).sum()
    assert (geometry.inliers & ~right).sum() <= 3 * by_chance + 3
    assert precision > 0.96
    assert geometry.log10_nfa < -200
    assert 0.4 < geometry.threshold_px < 6


def test_the_model_is_the_true_one() -> None:
    xy1, xy2, right = pair_of_views(600, 0.4, 0.3, 5)
    truth = fit_hyperplane(np.column_stack([xy1, xy2])[right])
    geometry = estimate(xy1, xy2)
    estimated = np.array([geometry.matrix[2, 0], geometry.matrix[2, 1], geometry.matrix[0, 2], geometry.matrix[1, 2],
                          geometry.matrix[2, 2]])  # fmt: skip
    clean = np.column_stack([xy1, xy2])[right]
    distance = epipolar_distance_px(estimated, clean)
    assert np.median(distance) < 1.15 * np.median(epipolar_distance_px(truth, clean))


def test_the_threshold_grows_with_the_noise() -> None:
    thresholds = [
        np.median([estimate(*pair_of_views(500, 0.3, noise, seed)[:2]).threshold_px for seed in range(3)])
        for noise in (0.1, 0.3, 1.0, 2.0)
    ]
    assert (np.diff(thresholds) > 0).all()
    assert 5 < thresholds[3] / thresholds[0] < 60  # twenty times the noise


def test_noise_holds_no_meaningful_model() -> None:
    """NFA < 0.01 must come about once in a hundred draws of uniform matches, by its definition; at most 3 here."""
    alarms = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        xy1, xy2 = (rng.uniform(0, 1, (120, 2)) * (SHAPE[1], SHAPE[0]) for _ in range(2))
        alarms += estimate(xy1, xy2, seed, max_trials=500).log10_nfa < -2
    assert alarms <= 3


def test_the_answer_is_consistent_with_itself() -> None:
    xy1, xy2, _ = pair_of_views(300, 0.5, 0.4, 7)
    geometry = estimate(xy1, xy2)
    np.testing.assert_array_equal(geometry.inliers, geometry.residual_px <= geometry.threshold_px)
    assert geometry.kind == "affine"
    assert np.linalg.norm(geometry.matrix) == pytest.approx(1)
    np.testing.assert_array_equal(geometry.matrix[:2, :2], 0)
    # Residuals are distances to epipolar lines: those of x1 in image 2, or of x2 in image 1, whichever is larger.
    one = np.ones((300, 1))
    lines2, lines1 = np.hstack([xy1, one]) @ geometry.matrix.T, np.hstack([xy2, one]) @ geometry.matrix
    product = np.abs((np.hstack([xy2, one]) * lines2).sum(axis=1))
    lengths = np.minimum(np.hypot(*lines1[:, :2].T), np.hypot(*lines2[:, :2].T))
    np.testing.assert_allclose(geometry.residual_px, product / lengths, rtol=1e-6, atol=1e-9)


def test_the_seed_decides_and_nothing_else() -> None:
    xy1, xy2, _ = pair_of_views(300, 0.5, 0.4, 8)
    first, again = estimate(xy1, xy2, 3), estimate(xy1, xy2, 3)
    np.testing.assert_array_equal(first.matrix, again.matrix)
    assert (first.log10_nfa, first.n_trials) == (again.log10_nfa, again.n_trials)


def test_easy_pairs_take_few_trials() -> None:
    xy1, xy2, _ = pair_of_views(500, 0.05, 0.3, 9)
    assert estimate(xy1, xy2, max_trials=5000).n_trials < 1000


@pytest.mark.parametrize("n", [0, 1, 4])
def test_fewer_than_five_matches_are_refused(n: int) -> None:
    with pytest.raises(TooFewMatchesError, match=f"{n} matches"):
        estimate(np.zeros((n, 2)), np.zeros((n, 2)))


def test_one_match_repeated_is_refused() -> None:
    with pytest.raises(TooFewMatchesError, match="degenerate"):
        estimate(np.full((50, 2), 30.0), np.full((50, 2), 33.0))


def test_matches_on_a_line_are_refused() -> None:
    along = np.linspace(0, 300, 60)
    xy1 = np.column_stack([along, 0.5 * along + 20])
    with pytest.raises(TooFewMatchesError, match="degenerate"):
        estimate(xy1, xy1 * 1.01 + 3)


def test_five_matches_are_no_evidence() -> None:
    rng = np.random.default_rng(0)
    geometry = estimate(rng.uniform(0, 500, (5, 2)), rng.uniform(0, 500, (5, 2)))
    assert geometry.log10_nfa > -2
