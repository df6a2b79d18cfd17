"""A sweep through all views makes smeared depth jumps crisp again, and leaves smooth surfaces alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from semscape.dense.semi_global import least_cost
from semscape.dense.sweep import _apart_from_jumps, sharpen_jumps
from semscape.types import BoolArray, FloatArray
from synthetic_views import COLUMNS, SHAPE, look_at


def test_a_smeared_wall_becomes_crisp() -> None:
    """Two planes 40 px apart, given with a ramp of 14 px: the wall comes back within 4 px, in its place."""
    wall = np.where(COLUMNS < 75, 40.0, 0.0)
    smeared = np.interp(COLUMNS, [68, 82], [40.0, 0.0])
    given = np.tile(smeared, (SHAPE[0], 1))
    inner = sharpen_jumps(given, look_at(wall))[12:-12, 30:-30]
    transition = (inner > 4) & (inner < 36)
    assert np.median(transition.sum(axis=1)) <= 4
    edge = (inner > 20).sum(axis=1) + 30
    assert abs(np.median(edge) - 75) <= 1.5


def test_a_right_surface_is_left_alone() -> None:
    slope = 20.0 + 8 * np.sin(COLUMNS / 25)
    given = np.tile(slope, (SHAPE[0], 1))
    sharp = sharpen_jumps(given, look_at(slope))
    assert (sharp != given)[10:-10, 10:-10].mean() < 0.02


def test_an_unknown_patch_that_the_views_agree_on_is_filled() -> None:
    plane = np.full(SHAPE[1], 15.0)
    given = np.tile(plane, (SHAPE[0], 1))
    holed = given.copy()
    holed[40:50, 60:75] = np.nan
    filled = sharpen_jumps(holed, look_at(plane))[40:50, 60:75]
    assert np.isfinite(filled).mean() > 0.5
    assert np.nanmedian(np.abs(filled - 15)) < 2.5


def test_a_patch_that_no_two_views_agree_on_stays_unknown() -> None:
    """Without texture the views differ by their noise alone, whatever the height: that is no agreement."""
    plane = np.full(SHAPE[1], 15.0)
    holed = np.tile(plane, (SHAPE[0], 1))
    patch = np.s_[35:55, 55:80]
    holed[patch] = np.nan
    bare, textured = look_at(plane), look_at(plane)
    rng = np.random.default_rng(8)
    for sampler in bare.samplers:
        around = sampler.image[25:65, 45:90]
        around[:] = 128 + gaussian_filter(rng.normal(0, 4, around.shape), 0.5)
    assert np.isfinite(sharpen_jumps(holed, textured)[patch]).mean() > 0.5
    assert np.isfinite(sharpen_jumps(holed, bare)[patch]).mean() < 0.1


def test_where_nothing_is_known_nothing_is_invented() -> None:
    unknown = np.full(SHAPE, np.nan)
    assert np.isnan(sharpen_jumps(unknown, look_at(np.full(SHAPE[1], 15.0)))).all()


def labelled(cost: np.ndarray, prior: np.ndarray, guide: np.ndarray) -> FloatArray:
    valid: BoolArray = np.ones(cost.shape[:2], bool)
    return least_cost(cost, np.zeros(cost.shape[:2], np.int32), valid, prior, guide, 6.0, 30.0)


def test_a_prior_slope_costs_nothing() -> None:
    """Where the costs say nothing between two ends, labels follow the prior's slope and not a stair."""
    true = np.arange(30) // 2 + 3
    cost = np.full((7, 30, 24), 20, np.uint8)
    for col in (0, 1, 2, 27, 28, 29):
        cost[:, col, true[col]] = 0
    prior = np.tile(true, (7, 1)).astype(np.int32)
    found = labelled(cost, prior, np.zeros((7, 30), np.float32))
    np.testing.assert_allclose(found[3], true, atol=0.6)


@pytest.mark.parametrize("edge", [12, 17])
def test_a_jump_goes_where_the_guide_has_its_edge(edge: int) -> None:
    cost = np.full((9, 30, 16), 20, np.uint8)
    cost[:, :8, 3] = 0
    cost[:, 22:, 11] = 0
    cost[:, 8:22, 3] = cost[:, 8:22, 11] = 10
    guide = np.where(np.arange(30) < edge, 0.0, 9.0).astype(np.float32) * np.ones((9, 1), np.float32)
    found = labelled(cost, np.zeros((9, 30), np.int32), guide)
    assert (np.abs(found[4, :edge] - 3) < 1).all()
    assert (np.abs(found[4, edge:] - 11) < 1).all()


def test_brightness_beside_a_jump_counts_little() -> None:
    """Within 3 px of a wall of 40 px, not along a slope of 4 px per px: 0.8 px of disparity are no jump."""
    height = np.tile(np.where(COLUMNS < 75, 40.0, 0.0) + 4.0 * COLUMNS, (SHAPE[0], 1))
    share = _apart_from_jumps(height, baseline=0.2)
    beside = (COLUMNS >= 72) & (COLUMNS <= 78)
    assert (share[:, beside] < 0.1).all()
    assert (share[:, ~beside] == 1).all()
    assert (share > 0).all()  # where jumps are everywhere they still say something
