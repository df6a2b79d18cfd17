"""The histogram's NFA against the exact one, and what early rejection may and may not do."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.robust.acransac import _Evidence
from semscape.robust.models import AFFINE, FUNDAMENTAL, HOMOGRAPHY, Model
from semscape.robust.ransac import ransac
from semscape.robust.score import checkpoints, least_nfa, log10_combinations
from semscape.robust.search import DistinctMatches, distinct_matches
from synthetic_pairs import SHAPES, pair_of_views


def some_models(model: Model, n: int, outliers: float) -> tuple[DistinctMatches, _Evidence, np.ndarray, np.ndarray]:
    x1, x2, _ = pair_of_views(n, outliers, 0.5, 4)
    rng = np.random.default_rng(0)
    matches = distinct_matches(model, x1, x2, SHAPES, rng=rng)
    samples = np.array([rng.choice(n, model.sample_size, replace=False) for _ in range(300)])
    matrices, count = model.solve_samples(matches.w, samples, matches.frame)
    return matches, _Evidence.of(model, matches, model.log10_alpha0(SHAPES)), matrices, count


@pytest.mark.parametrize("model", [AFFINE, FUNDAMENTAL, HOMOGRAPHY], ids=lambda model: model.kind)
def test_the_histogram_bounds_the_exact_nfa_closely(model: Model) -> None:
    matches, evidence, matrices, count = some_models(model, 1000, 0.4)
    values, thresholds = np.empty((300, model.max_solutions)), np.empty((300, model.max_solutions))
    evidence.of_models(matrices, count, np.inf, values, thresholds)
    for trial in range(300):
        for s in range(count[trial]):
            residual = model.residuals_px(matrices[trial, s], matches.points, matches.frame)
            exact, _ = least_nfa(residual, evidence.table, evidence.log_alpha0, model.sample_size, model.dimension)
            # The rounding of single precision may put a residual into the bin beside its own.
            assert exact - 0.5 <= values[trial, s] <= exact + 3 + 0.03 * abs(exact)
    assert np.isinf(values[count == 0]).all()


def test_rejection_spares_the_models_that_are_better() -> None:
    _, evidence, matrices, count = some_models(AFFINE, 5000, 0.5)
    full, pruned, thresholds = np.empty((300, 1)), np.empty((300, 1)), np.empty((300, 1))
    evidence.of_models(matrices, count, np.inf, full, thresholds)
    bar = float(np.sort(full[:, 0])[60])
    evidence.of_models(matrices, count, bar, pruned, thresholds)
    better = full[:, 0] < bar
    assert (pruned[better] == full[better]).mean() > 0.95
    assert np.isinf(pruned[~better]).mean() > 0.5


def test_likely_totals_hold_the_true_ones() -> None:
    """Three sigmas: of random parts of sets with known shares, nearly all leave the truth below the limit."""
    n = 8192
    stops, likely = checkpoints(n)
    assert stops.tolist() == [256, 1024, 4096]
    rng = np.random.default_rng(0)
    for row, m in zip(likely, stops, strict=True):
        assert (np.diff(row[: m + 1]) >= 0).all()
        for share in (0.02, 0.3, 0.9):
            seen = rng.hypergeometric(int(share * n), n - int(share * n), m, 2000)
            held = row[seen] >= int(share * n)
            assert held.mean() > 0.995
            assert row[seen].mean() < (share + 5 * np.sqrt(share / m) + 20 / m) * n
    assert len(checkpoints(300)[0]) == 0


def test_combinations_count_the_tests() -> None:
    table = log10_combinations(5000, 7, 3)
    assert np.isinf(table[:8]).all()
    assert np.isfinite(table[8:]).all()
    assert table[5000] == pytest.approx(np.log10(3 * 4993) + sum(np.log10((5000 - i) / (7 - i)) for i in range(7)))


def test_plain_ransac_takes_what_the_threshold_says() -> None:
    x1, x2, right = pair_of_views(500, 0.4, 0.5, 2)
    found = {
        limit: ransac(AFFINE, x1, x2, threshold_px=limit, shapes=SHAPES, rng=np.random.default_rng(0), max_trials=1000)
        for limit in (0.3, 1.8, 30.0)
    }
    for limit, fit in found.items():
        assert fit.threshold_px == limit
        assert np.isnan(fit.log10_nfa)
        np.testing.assert_array_equal(fit.inliers, fit.residual_px <= limit)
    assert found[0.3].inliers[right].mean() < 0.5  # too strict
    assert found[1.8].inliers[right].mean() > 0.95
    assert right[found[30.0].inliers].mean() < 0.97 < right[found[1.8].inliers].mean()  # too wide
