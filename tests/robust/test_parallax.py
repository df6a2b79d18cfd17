"""The limit of parallax: what it drops, what it keeps, and when it does nothing."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.robust.acransac import ac_ransac
from semscape.robust.models import AFFINE, FUNDAMENTAL
from semscape.robust.pair_geometry import two_view_geometry
from semscape.robust.parallax import limit_parallax
from semscape.robust.search import RobustFit
from synthetic_pairs import SHAPES, pair_of_views


def fitted(x1: np.ndarray, x2: np.ndarray, model=AFFINE) -> RobustFit:
    return ac_ransac(model, x1, x2, shapes=SHAPES, rng=np.random.default_rng(0), max_trials=10_000)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_wrong_matches_on_their_line_are_told(seed: int) -> None:
    x1, x2, right = pair_of_views(1000, 0.75, 1.5, seed)
    free = fitted(x1, x2)
    limited = limit_parallax(free, x1, x2, SHAPES)
    assert right[limited.inliers].mean() > 0.985
    wrong = [int((fit.inliers & ~right).sum()) for fit in (free, limited)]
    assert wrong[1] < 0.5 * wrong[0]
    assert limited.inliers[right].mean() > 0.93
    assert limited.log10_nfa < free.log10_nfa
    np.testing.assert_array_equal(limited.matrix, free.matrix)


def test_where_all_are_right_next_to_nothing_is_lost() -> None:
    x1, x2, _ = pair_of_views(600, 0.0, 0.4, 3)
    free = fitted(x1, x2)
    limited = limit_parallax(free, x1, x2, SHAPES)
    assert limited.inliers.sum() > 0.97 * free.inliers.sum()


def test_repeats_and_nan_change_nothing() -> None:
    x1, x2, _ = pair_of_views(400, 0.5, 0.5, 4)
    x1[0], x2[1] = np.nan, np.nan
    free = fitted(x1, x2)
    once = limit_parallax(free, x1, x2, SHAPES)
    assert not once.inliers[:2].any()
    double1, double2 = np.vstack([x1, x1]), np.vstack([x2, x2])
    twice = limit_parallax(fitted(double1, double2), double1, double2, SHAPES)
    np.testing.assert_array_equal(twice.inliers, np.tile(once.inliers, 2))
    assert twice.log10_nfa == once.log10_nfa


def test_other_models_have_no_such_limit() -> None:
    x1, x2, _ = pair_of_views(100, 0.0, 0.5, 4)
    with pytest.raises(ValueError, match="fundamental"):
        limit_parallax(fitted(x1, x2, FUNDAMENTAL), x1, x2, SHAPES)


def test_the_pair_is_limited_where_asked() -> None:
    x1, x2, right = pair_of_views(800, 0.8, 1.5, 1)
    free, limited = (
        two_view_geometry(
            (0, 1),
            x1,
            x2,
            kind="affine",
            shapes=SHAPES,
            rng=np.random.default_rng(0),
            max_trials=5000,
            parallax_limited=asked,
        )
        for asked in (False, True)
    )
    assert right[limited.inliers].mean() > right[free.inliers].mean()
    assert limited.log10_nfa == limited.log10_nfa_by_kind["affine"] < free.log10_nfa
