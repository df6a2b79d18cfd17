"""Specks in a surface that goes on are bridged; beside jumps, in holes and where the sides do not meet they stay."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.dense.bridge import without_specks
from semscape.dense.evidence import RefinedHeights
from semscape.types import BoolArray, FloatArray

BASELINE = 0.2
ROWS, COLS = np.indices((60, 80)).astype(float)


def bridged(true: FloatArray, unknown: BoolArray, sigma: FloatArray | float = 1.0) -> RefinedHeights:
    height = np.where(unknown, np.nan, true)
    uncertainty = np.where(unknown, np.nan, sigma)
    n_views = np.where(unknown, 0, 3 + (true.shape[1] // 2 > np.arange(true.shape[1]))).astype(np.uint8)
    period = np.where(unknown, np.nan, 12.0).astype(np.float32)
    return without_specks(RefinedHeights(height, uncertainty, n_views, period, 0.0, np.ones_like(period)), BASELINE)


def specks(seed: int = 0) -> BoolArray:
    """Return gaps of one to three pixels, some side by side."""
    rng, unknown = np.random.default_rng(seed), np.zeros(ROWS.shape, bool)
    for row in range(5, 55, 7):
        for col in range(5, 70, 9):
            unknown[row, col : col + rng.integers(1, 4)] = True
            unknown[row + rng.integers(0, 2), col + 1] = True
    return unknown


@pytest.mark.parametrize("slope", [0.0, 2.0, 4.5])
def test_gaps_of_a_steep_flank_are_bridged_by_its_own_slope(slope: float) -> None:
    """4.5 px of height per px are 0.9 px of disparity per px: over 5 px more than any jump."""
    true = slope * (0.8 * COLS + 0.6 * ROWS)
    found = bridged(true, specks())
    np.testing.assert_allclose(found.height, true, atol=1e-4)
    np.testing.assert_allclose(found.uncertainty, 1.0, atol=0.05)
    assert np.isfinite(found.lateral_period_px).all()
    assert found.n_views.min() == 3


def test_a_curved_surface_is_bridged_within_its_sigma() -> None:
    true = np.sqrt(np.maximum(60.0**2 - (COLS - 40) ** 2 - (ROWS - 30) ** 2, 0.0))
    unknown = specks(1)
    found = bridged(true, unknown, 0.5)
    assert np.isfinite(found.height).all()
    assert (np.abs(found.height - true)[unknown] < found.uncertainty[unknown]).all()
    assert (found.uncertainty[unknown] > 0.5 - 1e-9).all()


def test_nothing_is_bridged_at_a_wall() -> None:
    """A wall of 8 px of disparity: neither in it nor close beside it, where even known heights are not sure."""
    true = np.where(COLS < 40, 0.0, 8 / BASELINE)
    unknown = specks(2)
    found = bridged(true, unknown)
    beside = np.abs(COLS - 39.5) < 4
    assert np.isnan(found.height[unknown & beside]).all()
    far = np.abs(COLS - 39.5) > 8
    assert np.isfinite(found.height[far]).all()
    assert set(np.unique(found.height[np.isfinite(found.height)])) == {0.0, 8 / BASELINE}


def test_ground_that_a_wall_hides_stays_unknown() -> None:
    """A strip of three columns before a wall: its ends do not meet, whatever lies along it."""
    true = np.where(COLS < 40, 0.0, 3 / BASELINE)
    unknown = (COLS >= 37) & (COLS < 40)
    unknown[::2, 37] = False
    assert np.isnan(bridged(true, unknown).height[unknown]).all()


def test_a_hole_stays_a_hole() -> None:
    unknown = (ROWS >= 20) & (ROWS < 26) & (COLS >= 30) & (COLS < 36)
    found = bridged(COLS, unknown)
    assert np.array_equal(np.isnan(found.height), unknown)
    assert np.array_equal(found.n_views == 0, unknown)


def test_what_is_known_stays() -> None:
    rng = np.random.default_rng(3)
    true = COLS + rng.normal(0, 1.0, COLS.shape)
    unknown = specks(4)
    found = bridged(true, unknown)
    assert np.array_equal(found.height[~unknown], true[~unknown])
    assert np.isfinite(found.height).mean() > 0.99
    nothing = bridged(true, np.ones_like(unknown))
    assert np.isnan(nothing.height).all()
