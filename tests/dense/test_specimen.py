"""What stands on a stub is told from it; where nothing stands, nothing is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from semscape.dense.specimen import specimen_mask, with_specimen
from semscape.simulate.noise import fractal_field
from semscape.types import HeightMap, Reason

ROWS, COLUMNS = np.indices((200, 220))
RADIUS = np.hypot(ROWS - 90, COLUMNS - 120)


def found(height: NDArray[np.float64], reason: NDArray[np.uint8] | None = None) -> HeightMap:
    seen = np.isfinite(height).astype(np.uint8)
    told = np.where(seen, 0, Reason.INCONSISTENT).astype(np.uint8) if reason is None else reason
    sigma = np.where(seen, 0.5, np.nan)
    return HeightMap(height, sigma, 3 * seen, sigma.astype(np.float32), 1.0, np.diag([1.0, -1.0, 1.0, 1.0]), "um", told)


def noise(rms: float) -> NDArray[np.float64]:
    return np.random.default_rng(0).normal(0, rms, ROWS.shape)


def dome() -> NDArray[np.float64]:
    return np.where(RADIUS < 60, np.sqrt(np.maximum(70**2 - RADIUS**2, 0)), 0.0)


@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_a_dome_on_a_flat_stub(slope: float) -> None:
    mask = specimen_mask(found(dome() + slope * COLUMNS + noise(0.7)))
    assert np.mean(mask == (RADIUS < 60)) > 0.98


def test_a_dome_on_an_empty_stub_with_debris() -> None:
    height = np.where(RADIUS < 60, dome(), np.nan)
    height[170:176, 20:26] = 3.0
    height[85:95, 110:130] = np.nan  # a gap within the specimen belongs to it
    reason = np.where(np.isfinite(height), Reason.KNOWN, Reason.NO_TEXTURE).astype(np.uint8)
    mask = specimen_mask(found(height, reason))
    assert np.mean(mask == (RADIUS < 60)) > 0.99


@pytest.mark.parametrize(
    "height",
    [
        8 * fractal_field(ROWS.shape, 1.3, 120, 4.0, np.random.default_rng(1)),
        np.minimum(0.0, 0.4 * (np.maximum(abs(ROWS - 100), abs(COLUMNS - 110)) - 70.0)) + noise(0.3),  # an indent
        noise(1.0),
        20.0 * ((COLUMNS + ROWS) // 25 % 2) + noise(0.5),  # a grating
    ],
    ids=["fracture", "indent", "plane", "grating"],
)
def test_where_nothing_stands_the_whole_field_is_specimen(height: NDArray[np.float64]) -> None:
    assert specimen_mask(found(height)).all()


def test_keeping_the_specimen_leaves_the_stub_unknown_with_its_reason() -> None:
    given = found(dome() + noise(0.7))
    given = replace(given, lateral_period_um=np.full(given.height_um.shape, 12.0, np.float32))
    kept, every = with_specimen(given, "specimen"), with_specimen(given, "all")
    off = ~kept.specimen
    assert np.isnan(kept.height_um[off]).all()
    assert np.isnan(kept.uncertainty_um[off]).all()
    assert np.isnan(kept.texture[off]).all()
    assert np.array_equal(np.isnan(kept.lateral_period_um), off)
    assert (kept.reason[off] == Reason.BACKGROUND).all()
    assert not kept.n_views[off].any()
    assert np.array_equal(kept.height_um[~off], given.height_um[~off])
    assert np.array_equal(every.height_um, given.height_um)
    assert np.array_equal(every.specimen, kept.specimen)
