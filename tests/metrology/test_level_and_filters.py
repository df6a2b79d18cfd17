"""Forms are taken off exactly, outliers do not pull robust fits, and Gaussian filters pass what the standard says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semscape.errors import NoAnswerError
from semscape.metrology.filters import GAUSSIAN_ALPHA, gaussian_l_filter, gaussian_s_filter, profile_s_filter
from semscape.metrology.level import level
from semscape.metrology.outliers import find_outliers

ROWS, COLS = np.indices((60, 90)).astype(float)
RNG = np.random.default_rng(0)


def holed(z: np.ndarray) -> np.ndarray:
    out = z.copy()
    out[10:25, 30:50] = np.nan
    return out


@pytest.mark.parametrize(("form", "degree"), [("plane", 1), ("poly2", 2), ("poly3", 3), ("poly4", 4)])
def test_polynomials_are_removed_whole_and_one_degree_more_is_not(form, degree) -> None:
    x, y = COLS / 90, ROWS / 60
    z = sum(RNG.normal() * x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)) + 1e4
    found = level(holed(z), (0.1, 0.2), form)
    assert np.nanmax(np.abs(found.height)) < 1e-8
    assert np.isnan(found.height[15, 40])
    assert np.nanmax(np.abs(level(z + x ** (degree + 1), (0.1, 0.2), form).height)) > 1e-3


def test_none_leaves_the_heights() -> None:
    np.testing.assert_array_equal(level(ROWS, 1.0, "none").height, ROWS)


@pytest.mark.parametrize("radius", [150.0, -150.0, 60.0, 5e4])
def test_a_sphere_is_removed_and_its_radius_found(radius) -> None:
    squared = (COLS - 50) ** 2 + (ROWS - 20) ** 2
    with np.errstate(invalid="ignore"):
        z = np.sign(radius) * np.sqrt(radius**2 - squared) + 3
    found = level(holed(z), 1.0, "sphere")
    assert found.radius == pytest.approx(radius, rel=1e-6)
    assert np.nanmax(np.abs(found.height)) < 1e-6


def test_robust_fits_ignore_particles_that_least_squares_follows() -> None:
    dirty = 0.02 * COLS + RNG.normal(0, 0.05, COLS.shape)
    dirty[(COLS > 60) & (ROWS < 30)] += 5  # 16 % of the field, on one side
    plain, robust = (level(dirty, 1.0, "plane", robust=flag).form for flag in (False, True))
    truth = 0.02 * COLS
    assert np.abs(plain - truth).max() > 1
    assert np.abs(robust - truth).max() < 0.02
    sphere = np.sqrt(300.0**2 - (COLS - 45) ** 2 - (ROWS - 30) ** 2) + RNG.normal(0, 0.02, COLS.shape)
    sphere[(COLS > 70) & (ROWS < 30)] += 2
    assert level(sphere, 1.0, "sphere", robust=True).radius == pytest.approx(300, rel=0.01)
    assert abs(level(sphere, 1.0, "sphere").radius / 300 - 1) > 0.05


def test_a_region_decides_the_fit_and_the_whole_map_is_levelled() -> None:
    step = 0.05 * COLS + np.where(COLS > 45, 3.0, 0.0)
    found = level(step, 1.0, "plane", region=COLS < 40)
    assert np.abs(found.height[:, :45]).max() < 1e-9
    np.testing.assert_allclose(found.height[:, 46:], 3.0)


def test_too_little_to_level() -> None:
    few = np.full((10, 10), np.nan)
    few[0, :2] = 1.0
    for form in ("plane", "sphere"):
        with pytest.raises(NoAnswerError, match="2 heights are known"):
            level(few, 1.0, form)
    with pytest.raises(ValueError, match="cylinder"):
        level(ROWS, 1.0, "cylinder")


@settings(max_examples=20, deadline=None)
@given(wavelength=st.floats(6.0, 60.0), index=st.floats(6.0, 40.0), angle=st.floats(0, np.pi))
def test_a_wave_passes_with_the_transmission_of_the_standard(wavelength, index, angle) -> None:
    rows, cols = np.indices((160, 160)) * 0.5
    wave = np.cos(2 * np.pi * (cols * np.cos(angle) + rows * np.sin(angle)) / wavelength)
    passed = gaussian_s_filter(wave, 0.5, index)
    expected = np.exp(-np.pi * (GAUSSIAN_ALPHA * index / wavelength) ** 2)
    # Where the whole window lies within the map.
    inner = slice(80, 81) if index > 39 else slice(int(2 * index) + 1, 160 - int(2 * index) - 1)
    middle = (inner, inner)
    if wave[middle].size:
        np.testing.assert_allclose(passed[middle], expected * wave[middle], atol=2e-3)
        np.testing.assert_allclose(
            gaussian_l_filter(wave, 0.5, index)[middle], (1 - expected) * wave[middle], atol=2e-3
        )


def test_half_passes_at_the_nesting_index_on_a_grid_with_two_spacings() -> None:
    cols = np.arange(800) * 0.25
    wave = np.tile(np.sin(2 * np.pi * cols / 10), (100, 1))
    assert gaussian_s_filter(wave, (0.25, 1.0), 10.0)[50, 300:500].max() == pytest.approx(0.5, abs=1e-3)
    assert profile_s_filter(wave[0], 0.25, 10.0)[300:500].max() == pytest.approx(0.5, abs=1e-3)


def test_unknown_heights_stay_unknown_and_do_not_leak() -> None:
    flat = np.full((80, 80), 7.0)
    gaps = np.where(RNG.random((80, 80)) < 0.4, np.nan, flat)
    smooth = gaussian_s_filter(gaps, 1.0, 12.0)
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(gaps))
    np.testing.assert_allclose(smooth[np.isfinite(smooth)], 7.0, rtol=1e-12)
    # A known pixel alone in the dark keeps its height: nothing else speaks.
    alone = np.full((80, 80), np.nan)
    alone[40, 40] = 3.0
    assert gaussian_s_filter(alone, 1.0, 30.0)[40, 40] == pytest.approx(3.0)


def test_the_filter_equals_the_plain_sum_of_the_standard() -> None:
    z = RNG.normal(size=(15, 18))
    z[3, 4] = np.nan
    length = 4.0
    rows, cols = np.indices(z.shape)
    for r, c in ((0, 0), (7, 9), (4, 4), (14, 17)):
        weight = np.exp(-np.pi * ((rows - r) ** 2 + (cols - c) ** 2) / (GAUSSIAN_ALPHA * length) ** 2)
        weight[(abs(rows - r) > length) | (abs(cols - c) > length) | np.isnan(z)] = 0
        expected = np.nansum(weight * z) / weight.sum()
        assert gaussian_s_filter(z, 1.0, length)[r, c] == pytest.approx(expected, rel=1e-9)


def test_only_what_stands_out_is_an_outlier() -> None:
    z = 0.5 * COLS + RNG.normal(0, 0.1, COLS.shape)
    spikes = [(5, 7), (30, 60), (57, 87)]
    for row, col in spikes:
        z[row, col] += 4
    z[40:, :20] = np.nan
    found = find_outliers(z, 8.0)
    assert {(int(r), int(c)) for r, c in np.argwhere(found)} == set(spikes)
    assert not find_outliers(np.where(COLS > 45, 5.0, 0.0) + RNG.normal(0, 0.1, COLS.shape), 8.0).any()  # a step stays
    assert not find_outliers(np.full((5, 5), np.nan), 6.0).any()
    with pytest.raises(ValueError, match="positive"):
        find_outliers(z, 0.0)
