"""A contrario RANSAC: it finds its own threshold, and says when there is nothing to find."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.errors import TooFewMatchesError
from semscape.experiments.synthetic_matches import SHAPES as IMAGES
from semscape.experiments.synthetic_matches import synthetic_pair
from semscape.robust.acransac import ac_ransac
from semscape.robust.affine_epipolar import epipolar_distance_px, fit_hyperplane
from semscape.robust.models import AFFINE, FUNDAMENTAL, HOMOGRAPHY, Model, essential
from semscape.robust.search import RobustFit
from synthetic_pairs import SHAPE, SHAPES, line_distances, pair_of_views, perspective_views

CALIBRATION = np.array([[5000.0, 0, 399.5], [0, 5000, 299.5], [0, 0, 1]])
MODELS = {"affine": AFFINE, "fundamental": FUNDAMENTAL, "homography": HOMOGRAPHY}
ALL_MODELS = {**MODELS, "essential": essential(CALIBRATION, CALIBRATION)}


def estimate(
    x1: np.ndarray, x2: np.ndarray, seed: int = 0, max_trials: int = 2000, model: Model = AFFINE, workers: int = 1
) -> RobustFit:
    rng = np.random.default_rng(seed)
    return ac_ransac(model, x1, x2, shapes=SHAPES, rng=rng, max_trials=max_trials, workers=workers)


def uniform_matches(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(rng.uniform(0, 1, (n, 2)) * (SHAPE[1], SHAPE[0]) for _ in range(2))  # type: ignore[return-value]


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6, 0.8])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_inliers_are_the_right_matches(outliers: float, seed: int) -> None:
    x1, x2, right = pair_of_views(800, outliers, 0.4, seed)
    found = estimate(x1, x2, max_trials=10_000)
    recall = found.inliers[right].mean()
    precision = right[found.inliers].mean()
    assert 0.9 < recall <= 1  # the threshold cuts the last tail of the noise
    # A wrong match lies within t of its line by chance with probability 2 t D / A: a perfect precision is impossible.
    by_chance = 2 * found.threshold_px * np.hypot(*SHAPE) / np.prod(SHAPE) * (~right).sum()
    assert (found.inliers & ~right).sum() <= 3 * by_chance + 3
    assert precision > 0.95
    assert found.log10_nfa < -100
    assert 0.4 < found.threshold_px < 6


def test_the_model_is_the_true_one() -> None:
    x1, x2, right = pair_of_views(600, 0.4, 0.3, 5)
    truth = fit_hyperplane(np.column_stack([x1, x2])[right])
    found = estimate(x1, x2).matrix
    estimated = np.array([found[2, 0], found[2, 1], found[0, 2], found[1, 2], found[2, 2]])
    clean = np.column_stack([x1, x2])[right]
    distance = epipolar_distance_px(estimated, clean)
    assert np.median(distance) < 1.15 * np.median(epipolar_distance_px(truth, clean))


def test_the_threshold_grows_with_the_noise() -> None:
    noise = np.array([0.1, 0.3, 1.0, 3.0])
    thresholds = [
        np.median([estimate(*pair_of_views(500, 0.3, sigma, seed)[:2]).threshold_px for seed in range(5)])
        for sigma in noise
    ]
    # In proportion but for a slow logarithm: wider bands hold more wrong matches, so they end earlier in the tail.
    assert np.polyfit(np.log(noise), np.log(thresholds), 1)[0] == pytest.approx(0.95, abs=0.1)


def test_wrong_matches_do_not_choose_the_lines() -> None:
    """A few matches far along their line decide its direction in least squares, and draw others after them.

    At 2 px and 80 % wrong matches, least squares alone keeps 1.7 times as many wrong ones as the true geometry.
    """
    figures, by_chance, unavoidable = [], 0, 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        pair = synthetic_pair(1000, 0.8, 2.0, rng=rng)
        found = ac_ransac(AFFINE, pair.x1, pair.x2, shapes=IMAGES, rng=rng, max_trials=10_000)
        figures.append((pair.right[found.inliers].mean(), found.inliers[pair.right].mean()))
        by_chance += int((found.inliers & ~pair.right).sum())
        unavoidable += int((~pair.right & (pair.true_residual_px() <= found.threshold_px)).sum())
    precision, recall = np.median(figures, axis=0)
    assert precision >= 0.97
    assert recall >= 0.9
    assert by_chance < 1.2 * unavoidable


@pytest.mark.parametrize("n", [20, 120, 1000])
@pytest.mark.parametrize("kind", MODELS)
def test_noise_holds_no_meaningful_model(n: int, kind: str) -> None:
    """NFA < 0.01 comes at most once in a hundred draws of uniform matches, by its definition."""
    alarms = [estimate(*uniform_matches(n, seed), seed, 300, MODELS[kind]).log10_nfa < -2 for seed in range(40)]
    assert sum(alarms) <= 2


@pytest.mark.parametrize("n", [6, 40, 3000])
def test_no_threshold_at_all_costs_no_more_than_its_share(n: int) -> None:
    """Whatever the data, the NFA of all matches together is above 1, so that noise has an honest answer."""
    assert estimate(*uniform_matches(n, 1), max_trials=200).log10_nfa < 20


def test_the_answer_is_consistent_with_itself() -> None:
    x1, x2, _ = pair_of_views(300, 0.5, 0.4, 7)
    for kind, model in MODELS.items():
        found = estimate(x1, x2, model=model)
        np.testing.assert_array_equal(found.inliers, found.residual_px <= found.threshold_px)
        assert found.kind == kind
        assert np.linalg.norm(found.matrix) == pytest.approx(1)
        assert found.residual_px.max() > found.threshold_px
        if kind != "homography":
            expected = line_distances(found.matrix, x1, x2)
            np.testing.assert_allclose(found.residual_px, expected, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(estimate(x1, x2).matrix[:2, :2], 0)


def test_the_nfa_is_that_of_its_definition() -> None:
    """The exact sum over sorted residuals, with factorials, not gamma functions."""
    from math import comb, log10

    x1, x2, _ = pair_of_views(60, 0.4, 0.5, 3)
    found = estimate(x1, x2)
    n, k = len(x1), int(found.inliers.sum())
    alpha = 2 * np.hypot(*SHAPE) / np.prod(SHAPE) * found.threshold_px
    expected = log10(n - 4) + log10(comb(n, k)) + log10(comb(k, 4)) + (k - 4) * log10(alpha)
    assert found.log10_nfa == pytest.approx(expected, rel=1e-9)


def test_images_of_two_sizes() -> None:
    """The smaller chance of the two images holds, and the frame of each image is its own."""
    x1, x2, right = pair_of_views(400, 0.3, 0.4, 2)
    same = estimate(x1, x2)
    shapes = (SHAPE, (1200, 1600))
    rng = np.random.default_rng(0)
    found = ac_ransac(AFFINE, x1, x2 * 2, shapes=shapes, rng=rng, max_trials=2000)
    assert found.inliers[right].mean() > 0.9
    assert found.log10_nfa < -100
    swapped = ac_ransac(AFFINE, x2 * 2, x1, shapes=shapes[::-1], rng=np.random.default_rng(0), max_trials=2000)
    assert swapped.log10_nfa == pytest.approx(found.log10_nfa, rel=0.02)
    assert same.inliers[right].mean() > 0.9


def test_the_seed_decides_and_nothing_else() -> None:
    x1, x2, _ = pair_of_views(900, 0.7, 0.4, 8)
    for model in ALL_MODELS.values():
        first = estimate(x1, x2, 3, 300, model)
        for workers in (1, 2, 3):
            again = estimate(x1, x2, 3, 300, model, workers)
            np.testing.assert_array_equal(first.matrix, again.matrix)
            np.testing.assert_array_equal(first.inliers, again.inliers)
            assert (first.log10_nfa, first.n_trials) == (again.log10_nfa, again.n_trials)


def test_easy_pairs_take_few_trials_and_hard_ones_all() -> None:
    x1, x2, _ = pair_of_views(500, 0.05, 0.3, 9)
    assert estimate(x1, x2, max_trials=5000).n_trials < 1000
    assert estimate(*uniform_matches(500, 0), max_trials=700).n_trials == 700


@pytest.mark.parametrize("kind", ["fundamental", "essential"])
def test_perspective_views_give_their_geometry(kind: str) -> None:
    x1, x2, truth, calibration = perspective_views(400, 0.3, 1)
    wrong = np.random.default_rng(0).permutation(400)[:120]
    x2[wrong] = np.random.default_rng(1).uniform(0, 1, (120, 2)) * (SHAPE[1], SHAPE[0])
    right = np.ones(400, dtype=bool)
    right[wrong] = False
    model = essential(calibration, calibration) if kind == "essential" else FUNDAMENTAL
    found = estimate(x1, x2, model=model, max_trials=1000)
    assert found.inliers[right].mean() > 0.93
    assert right[found.inliers].mean() > 0.95
    noise = np.median(line_distances(truth, x1, x2)[right])
    assert np.median(line_distances(found.matrix, x1, x2)[right]) < 1.15 * noise
    if kind == "essential":
        values = np.linalg.svd(calibration.T @ found.matrix @ calibration)[1]
        assert values[1] == pytest.approx(values[0], rel=1e-6)
        assert values[2] < 1e-9 * values[0]


def test_a_plane_gives_its_homography() -> None:
    rng = np.random.default_rng(4)
    x1 = rng.uniform(0, 1, (300, 2)) * (SHAPE[1], SHAPE[0])
    truth = np.array([[1.01, 0.02, 5.0], [-0.01, 0.98, -3.0], [1e-5, -2e-5, 1.0]])
    mapped = np.column_stack([x1, np.ones(300)]) @ truth.T
    x2 = mapped[:, :2] / mapped[:, 2:] + rng.normal(0, 0.3, (300, 2))
    x2[:150] = rng.uniform(0, 1, (150, 2)) * (SHAPE[1], SHAPE[0])
    found = estimate(x1, x2, model=HOMOGRAPHY)
    assert found.inliers[150:].mean() > 0.95
    assert found.inliers[:150].sum() <= 1
    np.testing.assert_allclose(found.matrix / found.matrix[2, 2], truth, atol=0.5, rtol=0.01)


# Degenerate input


@pytest.mark.parametrize("kind", ALL_MODELS)
@pytest.mark.parametrize("extra", [-99, -1, 0])
def test_no_more_matches_than_a_sample_are_refused(kind: str, extra: int) -> None:
    model = ALL_MODELS[kind]
    n = max(model.sample_size + extra, 0)
    with pytest.raises(TooFewMatchesError, match=rf"{n} matches.*at least {model.sample_size + 1}"):
        estimate(*(np.random.default_rng(0).uniform(0, 500, (2, n, 2))), model=model)


@pytest.mark.parametrize("kind", ALL_MODELS)
def test_one_match_repeated_is_refused(kind: str) -> None:
    with pytest.raises(TooFewMatchesError, match="1 of them distinct"):
        estimate(np.full((50, 2), 30.0), np.full((50, 2), 33.0), model=ALL_MODELS[kind])


@pytest.mark.parametrize("kind", ALL_MODELS)
def test_matches_on_a_line_are_refused(kind: str) -> None:
    along = np.linspace(0, 300, 60)
    x1 = np.column_stack([along, 0.5 * along + 20])
    with pytest.raises(TooFewMatchesError, match="degenerate"):
        estimate(x1, x1 * 1.01 + 3, model=ALL_MODELS[kind], max_trials=100)


def test_repeated_matches_are_no_more_evidence_than_single_ones() -> None:
    """Eight matches of chance, each listed fifty times, lie on no common model."""
    x1, x2 = uniform_matches(8, 5)
    found = estimate(np.repeat(x1, 50, axis=0), np.repeat(x2, 50, axis=0))
    assert found.log10_nfa > -1
    assert len(found.inliers) == 400
    once, twice = pair_of_views(200, 0.3, 0.4, 1)[:2], pair_of_views(200, 0.3, 0.4, 1)[:2]
    single = estimate(*once)
    double = estimate(*(np.vstack([xy, xy]) for xy in twice))
    assert double.log10_nfa == single.log10_nfa
    np.testing.assert_array_equal(double.inliers, np.tile(single.inliers, 2))


def test_matches_with_nan_are_never_inliers() -> None:
    x1, x2, right = pair_of_views(300, 0.2, 0.4, 3)
    x1[-20:, 0] = np.nan
    x2[-40:-20, 1] = np.inf
    found = estimate(x1, x2)
    assert not found.inliers[-40:].any()
    assert found.inliers[right][:-40].mean() > 0.9
    with pytest.raises(TooFewMatchesError, match="0 of them distinct and finite"):
        estimate(np.full((40, 2), np.nan), x2[:40])


def test_misshapen_matches_are_misuse() -> None:
    for x1, x2 in ((np.ones((9, 2)), np.ones((8, 2))), (np.ones((9, 3)), np.ones((9, 3))), (np.ones(9), np.ones(9))):
        with pytest.raises(ValueError, match=r"\(M, 2\)"):
            estimate(x1, x2)


def test_five_matches_are_no_evidence() -> None:
    rng = np.random.default_rng(0)
    assert estimate(rng.uniform(0, 500, (5, 2)), rng.uniform(0, 500, (5, 2))).log10_nfa > -2
