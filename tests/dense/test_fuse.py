"""Heights of several pairs: brought to zero tilt, and fused against outliers."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.dense.fuse import fuse, to_zero_tilt

COLUMNS = np.arange(120, dtype=float)


@pytest.mark.parametrize("parallax", [-0.15, 0.0, 0.1])
def test_a_slope_moves_to_where_it_stands(parallax: float) -> None:
    """Height a u at u is seen at u + a u g."""
    a = 0.5
    seen_at = COLUMNS / (1 + a * parallax)
    moved = to_zero_tilt(np.tile(a * seen_at, (3, 1)), parallax)
    inner = moved[:, 5:100]
    np.testing.assert_allclose(inner, np.tile(a * COLUMNS[5:100], (3, 1)), atol=1e-9)


def test_a_jump_is_not_bridged() -> None:
    """Where a wall faces away from the view the ground behind it is unseen: a gap, not a ramp."""
    height = np.where(COLUMNS < 60, 40.0, 0.0)[None]
    moved = to_zero_tilt(height, 0.2)[0]  # the top, up to 59, goes to 51; the ground stays
    assert np.isnan(moved[53:59]).all()
    np.testing.assert_allclose(moved[:51], 40.0)
    np.testing.assert_allclose(moved[61:], 0.0)
    assert set(np.unique(moved[np.isfinite(moved)])) == {0.0, 40.0}


def test_where_the_surface_folds_the_top_wins() -> None:
    height = np.where(COLUMNS < 60, 0.0, 40.0)[None]
    moved = to_zero_tilt(height, 0.2)[0]
    np.testing.assert_allclose(moved[53:110], 40.0)
    np.testing.assert_allclose(moved[:51], 0.0)


def test_unknown_stays_unknown() -> None:
    height = np.full((4, 120), np.nan)
    assert np.isnan(to_zero_tilt(height, 0.1)).all()
    height[1, 50] = 10.0
    moved = to_zero_tilt(height, 0.1)
    assert np.isfinite(moved).sum() <= 1
    assert moved[1, 49] == 10.0


def maps(n: int, sigma: float = 0.5, seed: int = 0) -> tuple[np.ndarray, list[np.ndarray]]:
    rng = np.random.default_rng(seed)
    true = 20 + 5 * np.sin(np.indices((30, 40))[1] / 5)
    return true, [true + rng.normal(0, sigma, true.shape) for _ in range(n)]


def test_one_wrong_map_changes_nothing() -> None:
    true, good = maps(3)
    bad = true + 30.0
    fused, support = fuse([*good[:2], bad, good[2]], [0.2, 0.2, 0.2, 0.2])
    alone, _ = fuse(good, [0.2] * 3)
    np.testing.assert_allclose(fused, alone)
    assert (support == 3).all()


def test_maps_are_weighted_by_their_baselines() -> None:
    wide, narrow = np.full((2, 2), 10.0), np.full((2, 2), 12.0)
    fused, support = fuse([wide, narrow], [0.2, 0.1])
    np.testing.assert_allclose(fused, (4 * 10 + 12) / 5)
    assert (support == 2).all()
    same, _ = fuse([wide, narrow], [-0.2, -0.1])
    np.testing.assert_allclose(same, fused)  # the sign of a baseline is a matter of order


def test_two_maps_that_disagree_say_nothing() -> None:
    fused, support = fuse([np.full((2, 2), 10.0), np.full((2, 2), 90.0)], [0.2, 0.2])
    assert np.isnan(fused).all()
    assert (support == 0).all()


def test_where_no_map_knows_the_fused_one_does_not() -> None:
    _, good = maps(3)
    for one in good:
        one[5:9, 5:9] = np.nan
    good[0][20, 20] = np.nan
    fused, support = fuse(good, [0.2] * 3)
    assert np.isnan(fused[5:9, 5:9]).all()
    assert np.isnan(fused).sum() == 16
    assert support[20, 20] == 2


def test_fusing_averages_the_noise() -> None:
    true, good = maps(6)
    fused, _ = fuse(good, [0.2] * 6)
    assert np.std(fused - true) == pytest.approx(0.5 / np.sqrt(6), rel=0.15)


def test_the_order_of_the_maps_does_not_matter() -> None:
    _, good = maps(4)
    one, _ = fuse(good, [0.1, 0.2, 0.15, 0.3])
    two, _ = fuse(good[::-1], [0.3, 0.15, 0.2, 0.1])
    np.testing.assert_allclose(one, two, rtol=1e-12)
