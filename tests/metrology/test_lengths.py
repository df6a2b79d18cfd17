"""Profiles, steps, planes, volumes, distances and registered differences of surfaces that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from semscape.errors import NoAnswerError
from semscape.metrology.grid import Region
from semscape.metrology.planes import angle_between, fit_plane
from semscape.metrology.profile import Profile, extract_profile, profile_parameters
from semscape.metrology.register import compare, resample
from semscape.metrology.step import step_along_profile, step_between_regions
from semscape.metrology.volume import distance, volumes

RNG = np.random.default_rng(0)
ROWS, COLS = np.indices((100, 140)).astype(float)


def test_a_profile_runs_along_its_line_on_any_grid() -> None:
    z = 2.0 * COLS * 0.5 + 3.0 * ROWS * 0.25
    line = extract_profile(z, (0.5, 0.25), np.array([10.0, 20.0]), np.array([110.0, 80.0]))
    length = np.hypot(100 * 0.5, 60 * 0.25)
    assert line.distance[-1] == pytest.approx(length)
    assert line.step == pytest.approx(length / (len(line.distance) - 1))
    slope = (2 * 50 + 3 * 15) / length
    np.testing.assert_allclose(line.height, z[20, 10] + slope * line.distance, rtol=1e-9)


def test_profile_parameters_of_a_sine_on_a_slope() -> None:
    x = np.arange(0, 80, 0.02)
    line = Profile(x, 2 * np.sin(2 * np.pi * x / 0.8) + 0.3 * x, 0.02)
    found = profile_parameters(line, 8.0)
    assert found["Pa"] == pytest.approx(4 / np.pi, rel=0.01)
    assert found["Pq"] == pytest.approx(np.sqrt(2), rel=0.01)
    for name, expected in (("Ra", 4 / np.pi), ("Rq", np.sqrt(2)), ("Rz", 4), ("Rt", 4)):
        assert found[name] == pytest.approx(expected, rel=0.02), name
    assert found["sections"] == 5
    # A wave of the nesting index itself passes with half its height.
    long = profile_parameters(Profile(x, np.sin(2 * np.pi * x / 8), 0.02), 8.0)
    assert long["Rq"] == pytest.approx(0.5 / np.sqrt(2), rel=0.05)


def test_rz_is_the_mean_over_sections_and_rt_is_not() -> None:
    x = np.arange(0, 60, 0.1)
    z = np.sin(2 * np.pi * x / 1.0)
    z[300] += 9  # in the middle section alone
    found = profile_parameters(Profile(x, z, 0.1), 10.0)
    wave = 2 * np.cos(np.deg2rad(18))  # ten samples a wave miss its crest
    assert found["Rt"] - wave == pytest.approx(5 * (found["Rz"] - wave), rel=0.02)
    assert profile_parameters(Profile(x, z, 0.1), 20.0)["sections"] == 2
    assert np.isnan(profile_parameters(Profile(x, z, 0.1), 40.0)["Rz"])
    assert np.isnan(profile_parameters(Profile(x, z, 0.1), 60.0)["Ra"])
    assert "Ra" not in profile_parameters(Profile(x, z, 0.1))


def test_a_profile_over_nothing_is_no_answer() -> None:
    with pytest.raises(NoAnswerError, match="along the profile"):
        extract_profile(np.full((20, 20), np.nan), 1.0, np.array([1.0, 1.0]), np.array([15.0, 15.0]))


def test_a_step_on_a_slope() -> None:
    z = 0.07 * COLS - 0.02 * ROWS + np.where(COLS >= 70, 2.5, 0.0) + RNG.normal(0, 0.01, COLS.shape)
    found = step_between_regions(z, 1.0, Region(5, 5, 60, 90).mask(z.shape), Region(80, 5, 135, 90).mask(z.shape))
    assert found.height == pytest.approx(2.5, abs=0.002)
    assert found.perpendicular == pytest.approx(2.5 / np.sqrt(1 + 0.07**2 + 0.02**2), abs=0.002)
    assert found.residual_rms == pytest.approx(0.01, rel=0.1)
    line = extract_profile(z, 1.0, np.array([0.0, 50.0]), np.array([139.0, 50.0]))
    assert step_along_profile(line, (69.5,)).height == pytest.approx(2.5, abs=0.01)
    with pytest.raises(NoAnswerError, match="hold 0 and"):
        step_between_regions(z, 1.0, Region(500, 5, 600, 90).mask(z.shape), Region(80, 5, 135, 90).mask(z.shape))


def test_a_groove_counts_its_middle_third_and_its_rims_clear_of_the_edges() -> None:
    x = np.arange(0, 90, 0.1)
    z = 0.01 * x - np.where((x > 30) & (x < 60), 1.5, 0.0)
    clean = step_along_profile(Profile(x, z, 0.1), (30.0, 60.0))
    assert clean.height == pytest.approx(-1.5)
    rounded = z.copy()
    rounded[(np.abs(x - 30) < 9.5) | (np.abs(x - 60) < 9.5)] += 5  # within a third of the width of an edge
    assert step_along_profile(Profile(x, rounded, 0.1), (60.0, 30.0)).height == pytest.approx(-1.5)
    with pytest.raises(NoAnswerError, match="draw it longer"):
        step_along_profile(Profile(x, z, 0.1), (20.0, 60.0))
    with pytest.raises(ValueError, match="got 3"):
        step_along_profile(Profile(x, z, 0.1), (1.0, 2.0, 3.0))


def test_the_angle_of_a_roof() -> None:
    z = np.where(COLS < 70, COLS, 140 - COLS) * np.tan(np.deg2rad(20)) * 0.5
    left, right = (fit_plane(z, 0.5, Region(x0, 5, x0 + 50, 95).mask(z.shape)) for x0 in (5, 80))
    assert np.rad2deg(angle_between(left, right)) == pytest.approx(40, abs=1e-6)
    assert np.rad2deg(left.tilt_rad) == pytest.approx(20, abs=1e-6)
    assert left.normal[0] < 0 < right.normal[0]  # a rising slope leans back
    up = fit_plane(ROWS, 1.0, np.ones(ROWS.shape, bool))
    assert up.normal[1] > 0  # rows go down, world y goes up: height grows towards -y
    with pytest.raises(NoAnswerError, match="2 known heights"):
        fit_plane(z, 0.5, Region(5, 5, 6, 5).mask(z.shape))


def test_volumes_of_a_cone_and_what_is_unknown() -> None:
    cone = np.maximum(40 - np.hypot(ROWS - 50, COLS - 70), 0) * 0.5
    found = volumes(cone, 0.5)
    assert found.above == pytest.approx(np.pi * 20**2 * 20 / 3, rel=2e-3)
    assert found.below == 0
    half = volumes(cone, 0.5, 10.0)
    assert half.above == pytest.approx(np.pi * 10**2 * 10 / 3, rel=5e-3)
    assert half.above - half.below == pytest.approx(found.above - 10 * found.known_area)
    cone[:, :10] = np.nan
    assert volumes(cone, 0.5).unknown_area == pytest.approx(1000 * 0.25)


def test_distances() -> None:
    found = distance(3.0 * COLS, (1.0, 2.0), np.array([2.0, 3.0]), np.array([5.0, 5.0]))
    assert (found.lateral, found.vertical, found.spatial) == pytest.approx((5, 9, np.hypot(5, 9)))


def texture(n: int) -> np.ndarray:
    fine, coarse = (ndimage.gaussian_filter(RNG.normal(size=(n, n)), s) for s in (4, 25))
    return 5 * fine / fine.std() + 15 * coarse / coarse.std()


def test_wear_is_measured_after_a_rigid_motion() -> None:
    scene = texture(420)
    shift = np.eye(4)
    shift[:2, 3] = -70
    first_from_second = np.eye(4)
    first_from_second[:3, :3] = Rotation.from_rotvec([0.02, -0.015, 0.04]).as_matrix()
    first_from_second[:3, 3] = 14.3, -9.6, 6.0
    first = scene[70:330, 70:330] + RNG.normal(0, 0.2, (260, 260))
    second = resample(scene, np.linalg.inv(first_from_second) @ shift, (250, 270), (1.0, 1.0))
    second += RNG.normal(0, 0.2, second.shape)
    second[100:150, 120:180] -= 6.0
    found = compare(first, second, 1.0)
    corners = np.array([[0, 0, 0, 1], [260, 0, 0, 1], [0, 260, 0, 1], [260, 260, 20, 1]]).T
    np.testing.assert_allclose((found.first_from_second @ corners)[:3], (first_from_second @ corners)[:3], atol=0.05)
    assert found.overlap > 0.9
    worn = np.nansum(np.where(found.difference < -3, -found.difference, 0))
    assert worn == pytest.approx(50 * 60 * 6, rel=0.03)
    assert found.residual_sigma < 0.4


def test_a_map_does_not_differ_from_itself() -> None:
    z = texture(150)
    found = compare(z, z, 0.2)
    assert np.nanmax(np.abs(found.difference)) < 1e-6
    with pytest.raises(NoAnswerError, match="second map has 0"):
        compare(z, np.full((50, 50), np.nan), 0.2)
