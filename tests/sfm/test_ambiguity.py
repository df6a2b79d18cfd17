"""The bottom of the adjustment, its mirror image, and the valley between reliefs tilted less and more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from restarted import moved_by_restart_deg
from semscape.experiments.simulated_tracks import SimulatedTracks, TrackRecipe, simulate_tracks
from semscape.options import SfmOptions
from semscape.sfm.adjust import Problem, adjust, with_translations
from semscape.sfm.anisotropy import adjust_learning_anisotropy
from semscape.sfm.calibrate import Calibration, calibrate
from semscape.sfm.models import TiltSeriesModel, by_anisotropy_sigma
from semscape.sfm.priors import motion_prior

TILTS = (-6.0, -3.0, 0.0, 3.0, 6.0)


def solved(recipe: TrackRecipe, seed: int = 0) -> tuple[SimulatedTracks, Calibration]:
    tracks = simulate_tracks(recipe, rng=np.random.default_rng(seed))
    return tracks, calibrate(tracks.series, tracks.observations, SfmOptions(), rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def alone() -> tuple[SimulatedTracks, Calibration]:
    return solved(TrackRecipe(TILTS, n_points=500))


@pytest.fixture(scope="module")
def staged() -> tuple[SimulatedTracks, Calibration]:
    return solved(TrackRecipe(TILTS, 0.1, n_points=500))


def test_only_the_stage_tells_the_mirror_image(
    alone: tuple[SimulatedTracks, Calibration], staged: tuple[SimulatedTracks, Calibration]
) -> None:
    assert abs(alone[1].reconstruction.mirror_margin) < 0.01
    # Tilts of 6, 3, 3, 6 deg the wrong way, against readings of 0.1 deg: of the order of 4 * 90 / 0.01
    assert 5e3 < staged[1].reconstruction.mirror_margin < 1e5


def test_the_stage_narrows_the_valley(
    alone: tuple[SimulatedTracks, Calibration], staged: tuple[SimulatedTracks, Calibration]
) -> None:
    images, both = alone[1].reconstruction, staged[1].reconstruction
    assert images.height_scale_relative_sigma == pytest.approx(images.height_scale_relative_sigma_of_images, rel=1e-6)
    assert both.height_scale_relative_sigma < 0.3 * both.height_scale_relative_sigma_of_images
    two = solved(TrackRecipe((-3.0, 3.0), 0.1, n_points=500))[1].reconstruction
    assert two.height_scale_relative_sigma_of_images == np.inf
    assert two.height_scale_relative_sigma == pytest.approx(0.1 * np.sqrt(2) / 6, rel=0.1)


@pytest.mark.parametrize("stage_sigma_deg", [None, 0.1])
def test_a_restart_with_tighter_tolerance_stays(stage_sigma_deg: float | None) -> None:
    tracks = simulate_tracks(TrackRecipe(TILTS, stage_sigma_deg, n_points=500), rng=np.random.default_rng(3))
    assert moved_by_restart_deg(tracks.series, tracks.observations) < 0.001


def test_the_way_up_the_valley_leads_back() -> None:
    tracks = simulate_tracks(TrackRecipe(TILTS, n_points=500), rng=np.random.default_rng(3))
    prior = motion_prior(tracks.series, SfmOptions())
    searched = prior.centre_and_sigma()[0]
    searched[0] = np.pi / 2
    ends = []
    for stretch in (1.1, 0.9):
        searched[1::4] = np.deg2rad(TILTS) * stretch
        start = with_translations(searched, tracks.observations, len(TILTS))
        ends.append(adjust(start, tracks.observations, prior, max_iterations=50).parameters[1::6])
    assert np.rad2deg(np.abs(ends[1] - ends[0])).max() < 0.001


def test_the_priors_stand_beside_the_posterior(staged: tuple[SimulatedTracks, Calibration]) -> None:
    found = staged[1].reconstruction
    np.testing.assert_allclose(found.prior_mean[1::4], found.tilt_prior_rad)
    np.testing.assert_allclose(np.rad2deg(found.prior_sigma[1::4]), 0.1)
    assert (found.tilt_sigma_rad < found.prior_sigma[1::4]).all()


TOLD = SfmOptions().prior_anisotropy
THREE = (-6.0, 0.0, 6.0)


@pytest.mark.parametrize(
    ("tilts", "true", "least", "most"),
    [
        ((-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0), 0.0, 0.0, 0.3),
        ((-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0), 3 * TOLD, 1.5, 6.0),
        (THREE, 0.0, 0.999, 1.001),  # three views tell nothing: what is told stands
    ],
)
def test_the_anisotropy_is_learnt_where_the_images_tell_it(
    tilts: tuple[float, ...], true: float, least: float, most: float
) -> None:
    found = solved(TrackRecipe(tilts, n_points=500, anisotropy_sigma=true), 2)[1].reconstruction
    assert least * TOLD < found.prior_sigma[4] < most * TOLD


@pytest.mark.parametrize("true", [0.0, TOLD])
def test_three_views_state_the_interval_of_the_told_anisotropy(true: float) -> None:
    """Whatever the estimate rests on: that three views happen to agree narrows nothing."""
    tracks = simulate_tracks(TrackRecipe(THREE, n_points=500, anisotropy_sigma=true), rng=np.random.default_rng(4))
    prior = motion_prior(tracks.series, SfmOptions())
    searched = prior.centre_and_sigma()[0]
    searched[0], searched[1::4] = np.pi / 2, np.deg2rad(THREE)
    start = with_translations(searched, tracks.observations, len(THREE))
    told = adjust(start, tracks.observations, prior, max_iterations=50)
    learnt, found = adjust_learning_anisotropy(told, tracks.observations, prior, max_iterations=50, overdispersion=1.0)
    assert learnt.expected_anisotropy == TOLD
    apart = (told.parameters - found.parameters)[1::6]
    about = np.diag(told.covariance)[1::6] + apart**2
    np.testing.assert_allclose(np.diag(found.covariance)[1::6], about, rtol=0.1)


def test_another_anisotropy_is_where_an_adjustment_with_it_ends() -> None:
    tracks = simulate_tracks(TrackRecipe(TILTS, 0.1, n_points=500, anisotropy_sigma=TOLD), rng=np.random.default_rng(4))
    prior = motion_prior(tracks.series, SfmOptions())
    searched = prior.centre_and_sigma()[0]
    searched[0] = np.pi / 2
    start = with_translations(searched, tracks.observations, len(TILTS))
    found, other = (
        adjust(start, tracks.observations, replace(prior, anisotropy_sigma=sigma), max_iterations=50)
        for sigma in (TOLD, 0.5 * TOLD)
    )
    hessian = Problem(tracks.observations, TiltSeriesModel(prior)).normal_equations(
        found.parameters, found.weights / found.sigma_px**2
    )
    shift, covariance, _ = by_anisotropy_sigma(hessian.hessian, found.parameters[4::6], TOLD, np.array([0.5 * TOLD]))
    moved = (other.parameters - found.parameters)[1::6]
    assert np.abs(moved).max() > 1e-4
    np.testing.assert_allclose(shift[0, 1::6], moved, atol=0.1 * np.abs(moved).max())
    sigma = np.sqrt(np.diag(covariance[0]))
    np.testing.assert_allclose(sigma[1::6], np.sqrt(np.diag(other.covariance))[1::6], rtol=0.03)


def test_the_noise_free_anisotropy_prior_is_the_option() -> None:
    tracks = simulate_tracks(TrackRecipe(TILTS, n_points=100), rng=np.random.default_rng(0))
    assert motion_prior(tracks.series, replace(SfmOptions(), prior_anisotropy=0.004)).anisotropy_sigma == 0.004
