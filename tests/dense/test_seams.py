"""Tiles fade into each other: no step at their borders, and none across a depth jump is softened."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from semscape.dense.seams import Patch, Place, faded, strips_around
from semscape.types import FloatArray

FADE_PX, SHAPE = 8, (60, 70)
PLACES: list[Place] = [(slice(*rows), slice(*cols)) for rows, cols in product(((0, 28), (28, 60)), ((0, 36), (36, 70)))]
ROWS, COLS = np.indices(SHAPE).astype(float)
CURVED = 3 * np.sin(COLS / 9) + 0.02 * ROWS**2


def stitched(maps: list[FloatArray], sigmas: list[float]) -> tuple[FloatArray, FloatArray]:
    """Put four tiles' maps of the whole field together."""
    height, uncertainty = np.full(SHAPE, np.nan), np.full(SHAPE, np.nan)
    patches = [
        [
            Patch(core, place, found[place], np.where(np.isnan(found[place]), np.nan, sigma))
            for place in (core, *strips_around(core, SHAPE, FADE_PX))
        ]
        for core, found, sigma in zip(PLACES, maps, sigmas, strict=True)
    ]
    for k, place in enumerate(PLACES):
        others = [patch for j, rim in enumerate(patches) if j != k for patch in rim[1:]]
        height[place], uncertainty[place] = faded(patches[k][0], others, SHAPE, FADE_PX)
    return height, uncertainty


def test_tiles_that_agree_give_what_they_agree_on() -> None:
    height, uncertainty = stitched([CURVED] * 4, [0.5] * 4)
    np.testing.assert_allclose(height, CURVED, atol=1e-12)
    np.testing.assert_allclose(uncertainty, 0.5, atol=1e-12)


def test_a_step_between_tiles_becomes_a_ramp() -> None:
    """Levels of 0.0 to 0.6 px: from pixel to pixel the most is the largest difference over twice the fade."""
    levels, sigmas = [0.0, 0.2, 0.6, 0.3], [1.0, 1.2, 0.8, 1.0]
    height, uncertainty = stitched([CURVED + level for level in levels], sigmas)
    rest = height - CURVED
    largest = 0.6 / (2 * FADE_PX) + 1e-12
    assert np.abs(np.diff(rest, axis=0)).max() <= largest
    assert np.abs(np.diff(rest, axis=1)).max() <= largest
    # Linear across a border, away from the corners; half and half on it; each tile alone in its middle.
    np.testing.assert_allclose(rest[5, 28:44], 0.2 * (np.arange(16) + 0.5) / 16, atol=1e-12)
    np.testing.assert_allclose([rest[5, 5], rest[5, 60], rest[50, 5], rest[50, 60]], levels, atol=1e-12)
    np.testing.assert_allclose(rest[27:29, 35:37].mean(), np.mean(levels), atol=1e-12)
    # No less uncertain than the tiles, whose errors are the same noise.
    assert uncertainty.min() == pytest.approx(0.8)
    np.testing.assert_allclose(uncertainty[5, 28:44], 1 + 0.2 * (np.arange(16) + 0.5) / 16, atol=1e-12)


def test_tiles_that_see_different_surfaces_are_not_mixed() -> None:
    """Beside a jump one tile sees the top and the other the ground: the one in whose core it lies decides."""
    maps = [40.0 * (COLS - 6 * k >= 20) for k in range(4)]
    height, _ = stitched(maps, [1.0] * 4)
    assert set(np.unique(height)) == {0.0, 40.0}
    for place, found in zip(PLACES, maps, strict=True):
        assert np.array_equal(height[place], found[place])


def test_the_unknown_is_never_mixed_in() -> None:
    gaps = [np.random.default_rng(k).random(SHAPE) < 0.3 for k in range(4)]
    height, uncertainty = stitched([np.where(gap, np.nan, CURVED) for gap in gaps], [1.0] * 4)
    for place, gap in zip(PLACES, gaps, strict=True):
        assert np.array_equal(np.isnan(height[place]), gap[place])
        np.testing.assert_allclose(height[place][~gap[place]], CURVED[place][~gap[place]], atol=1e-12)
    assert np.array_equal(np.isnan(uncertainty), np.isnan(height))


def test_patches_from_elsewhere_change_nothing() -> None:
    core = PLACES[0]
    own = Patch(core, core, CURVED[core], np.ones((28, 36)))
    far = replace(own, core=PLACES[3], place=(slice(50, 60), slice(50, 70)), height=np.zeros((10, 20)))
    assert np.array_equal(faded(own, [far], SHAPE, FADE_PX)[0], faded(own, [], SHAPE, FADE_PX)[0])
