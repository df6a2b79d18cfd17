"""Bundle adjustment: its derivatives, its bottom, its noise estimate."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.errors import DegenerateGeometryError
from semscape.options import SfmOptions
from semscape.sfm.adjust import adjust
from semscape.sfm.models import camera_jacobians
from semscape.sfm.noise import noise_sigma_px, residual_overdispersion
from semscape.sfm.priors import motion_prior
from synthetic_tracks import PIXEL_UM, Tracks, make_tracks

TILTS = (-8.0, -4.0, 0.0, 4.0, 8.0)


def true_parameters(tracks: Tracks) -> np.ndarray:
    motion = tracks.motion
    per_view = np.column_stack(
        [
            motion.tilt_rad,
            motion.roll_rad,
            motion.scale_px_per_um * PIXEL_UM - 1,
            motion.anisotropy,
            motion.translation_px,
        ]
    )
    return np.concatenate([[motion.axis_angle_rad], per_view.ravel()])


def perturbed(parameters: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    start = parameters.copy()
    start[0] += 0.05
    start[1::6] += rng.normal(0, 0.005, 5)
    start[2::6] += rng.normal(0, 0.003, 5)
    start[3::6] += rng.normal(0, 0.002, 5)
    start[5::6] += rng.normal(0, 5, 5)
    start[6::6] += rng.normal(0, 5, 5)
    return start


def test_derivatives_equal_finite_differences() -> None:
    rng = np.random.default_rng(0)
    parameters = rng.normal(0, 0.2, 1 + 6 * 4)
    scale = rng.uniform(5, 15, 4)
    matrices, derivatives, translations = camera_jacobians(parameters, scale)
    np.testing.assert_array_equal(translations, parameters[1:].reshape(4, 6)[:, 4:])
    step = 1e-6
    for which in range(5):  # axis, tilt, roll, scale, anisotropy
        up, down = parameters.copy(), parameters.copy()
        index = [0] if which == 0 else [1 + 6 * view + which - 1 for view in range(4)]
        up[index] += step
        down[index] -= step
        numeric = (camera_jacobians(up, scale)[0] - camera_jacobians(down, scale)[0]) / (2 * step)
        np.testing.assert_allclose(derivatives[:, which], numeric, atol=1e-7)
    assert matrices.shape == (4, 2, 3)


def test_clean_tracks_give_the_motion_exactly() -> None:
    tracks = make_tracks(TILTS, stage_deg=TILTS, n_points=300, noise_px=0.0)
    prior = motion_prior(tracks.series, SfmOptions())
    found = adjust(perturbed(true_parameters(tracks)), tracks.observations, prior, max_iterations=50)
    assert np.abs(found.residual_px).max() < 1e-2
    tilts = np.rad2deg(found.parameters[1::6])
    np.testing.assert_allclose(np.diff(tilts), 4.0, atol=0.01)


def test_adjustment_ends_at_one_bottom_from_any_start() -> None:
    """Generic bundle adjustment stops early in the bas-relief valley; this one must not."""
    tracks = make_tracks(TILTS, stage_deg=TILTS, n_points=400)
    prior = motion_prior(tracks.series, SfmOptions())
    ends = [
        adjust(perturbed(true_parameters(tracks), seed), tracks.observations, prior, max_iterations=50)
        for seed in range(4)
    ]
    for end in ends[1:]:
        np.testing.assert_allclose(end.parameters[1::6], ends[0].parameters[1::6], atol=1e-6)
        assert end.cost == pytest.approx(ends[0].cost, rel=1e-4)  # the robust weights stop at a tolerance


WEAK = SfmOptions(prior_tilt_deg=20.0, prior_roll_deg=20.0, prior_scale=0.5, prior_anisotropy=0.5)


def roll_difference_sigma(covariance: np.ndarray) -> float:
    """Return the sigma of the first roll against the last: a common roll is a matter of choice."""
    first, last = 2, 2 + 6 * 4
    return float(np.sqrt(covariance[first, first] + covariance[last, last] - 2 * covariance[first, last]))


def test_covariance_is_symmetric_positive_and_scales_with_the_noise() -> None:
    sigmas = []
    for noise in (0.2, 0.4):
        tracks = make_tracks(TILTS, stage_deg=TILTS, n_points=400, noise_px=noise)
        found = adjust(
            true_parameters(tracks), tracks.observations, motion_prior(tracks.series, WEAK), max_iterations=50
        )
        sigma = np.sqrt(np.diag(found.covariance))
        correlation = found.covariance / np.outer(sigma, sigma)
        np.testing.assert_allclose(correlation, correlation.T, atol=1e-4)
        assert np.abs(correlation).max() < 1 + 1e-6
        sigmas.append(roll_difference_sigma(found.covariance))
    assert sigmas[1] / sigmas[0] == pytest.approx(2, rel=0.1)


def test_overdispersion_widens_the_covariance() -> None:
    tracks = make_tracks(TILTS, stage_deg=TILTS, n_points=300)
    prior = motion_prior(tracks.series, WEAK)
    start = true_parameters(tracks)
    plain = adjust(start, tracks.observations, prior, max_iterations=50)
    wide = adjust(start, tracks.observations, prior, max_iterations=50, overdispersion=4.0)
    assert roll_difference_sigma(wide.covariance) / roll_difference_sigma(plain.covariance) == pytest.approx(2, rel=0.1)


def test_wrong_matches_get_little_weight() -> None:
    tracks = make_tracks(TILTS, stage_deg=TILTS, n_points=400, seen=1.0)
    xy = tracks.observations.xy.copy()
    xy[7::50] += 30.0
    observations = type(tracks.observations)(tracks.observations.view, tracks.observations.point, xy)
    found = adjust(true_parameters(tracks), observations, motion_prior(tracks.series, SfmOptions()), max_iterations=50)
    assert np.median(found.weights[7::50]) < 0.01
    assert np.median(found.weights) > 0.7


def test_noise_is_estimated_from_residuals_of_any_track_length() -> None:
    rng = np.random.default_rng(0)
    length = rng.integers(3, 8, 5000)
    point = np.repeat(np.arange(5000), length)
    residual = rng.normal(0, 0.5, (len(point), 2)) * np.sqrt((2 * length - 3) / (2 * length))[point][:, None]
    view = np.concatenate([np.arange(n) for n in length])
    observations = type(make_tracks().observations)(view, point, np.zeros((len(point), 2)))
    weights = np.ones(len(point))
    assert noise_sigma_px(residual, observations, weights) == pytest.approx(0.5, rel=0.03)


def test_outliers_in_most_tracks_are_no_noise() -> None:
    """Of tracks of ten views two in three hold one of 10 % of wrong observations."""
    tilts = tuple(np.linspace(-13.5, 13.5, 10).tolist())
    tracks = make_tracks(tilts, stage_deg=tilts, n_points=300, seen=1.0, wrong=0.1)
    prior = motion_prior(tracks.series, SfmOptions())
    found = adjust(true_parameters(tracks), tracks.observations, prior, max_iterations=50)
    assert found.sigma_px == pytest.approx(0.3, rel=0.1)


def test_smooth_errors_count_as_overdispersion() -> None:
    tracks = make_tracks(TILTS, n_points=600, seen=1.0)
    observations = tracks.observations
    rng = np.random.default_rng(0)
    residual = rng.normal(0, 0.3, (len(observations.view), 2)) * np.sqrt(7 / 10)
    weights = np.ones(len(residual))
    assert residual_overdispersion(residual, observations, weights, 0.3, 5) < 1.3
    wave = 0.2 * np.sin(observations.xy / 150.0)
    assert residual_overdispersion(residual + wave, observations, weights, 0.3, 5) > 3


def test_a_singular_problem_says_so() -> None:
    tracks = make_tracks(TILTS, n_points=60, relief=0.0, noise_px=0.0)
    prior = motion_prior(tracks.series, SfmOptions())
    start = true_parameters(tracks)
    start[1::6] = 0.0  # equal tilts, no relief: depth is not observed at all
    with pytest.raises(DegenerateGeometryError):
        adjust(start, tracks.observations, prior, max_iterations=5)
