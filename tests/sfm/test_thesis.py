"""The textbook route: right for a camera, and honest about what it makes of a microscope."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.experiments.simulated_tracks import TrackRecipe, simulate_tracks
from semscape.geometry.rotations import axis_rotation
from semscape.options import SfmOptions
from semscape.sfm.thesis import ThesisPair, reprojection_errors, thesis_calibration, thesis_motion


def pinhole_rays(tilt_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return matches of a near scene about (0, 0, 3) that turns, and the motion that explains them."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (60, 3)) + np.array([0, 0, 3.0])
    rotation = axis_rotation(np.pi / 2, np.deg2rad(tilt_deg))
    translation = np.array([0, 0, 3.0]) - rotation @ [0, 0, 3.0]
    length = np.linalg.norm(translation)
    moved = points @ rotation.T + translation
    azimuth = np.arctan2(translation[1], translation[0])
    motion = np.array([0, np.deg2rad(tilt_deg), 0, azimuth, np.arcsin(translation[2] / length)])
    return np.hstack([points[:, :2] / points[:, 2:], moved[:, :2] / moved[:, 2:]]), motion


def test_the_true_motion_reprojects_exactly() -> None:
    rays, motion = pinhole_rays(8.0)
    wrong = motion + np.array([0.02, 0, 0, 0, 0])
    right_error, wrong_error = reprojection_errors(np.stack([motion, wrong]), rays)
    assert right_error < 1e-9
    assert wrong_error > 1e-4


def test_what_it_gives_on_a_series_is_told() -> None:
    tracks = simulate_tracks(
        TrackRecipe((-6.0, 0.0, 6.0), n_points=200, outlier_share=0.0), rng=np.random.default_rng(0)
    )
    options = SfmOptions(de_generations=40)
    found = thesis_motion(tracks.series, tracks.observations, options, rng=np.random.default_rng(0))
    assert len(found.pairs) == 2
    assert found.tilt_rad[0] == 0
    for pair in found.pairs:
        assert pair.rms_px[1] <= pair.rms_px[0]  # the search starts from the essential matrix
        assert pair.rms_px[1] < 2.0
        assert bool(pair.failure) == (pair.in_front < 0.75)
    assert len(found.failures) == sum(bool(pair.failure) for pair in found.pairs)


def test_its_tilts_have_no_stated_uncertainty() -> None:
    """They are held while the rest is fitted, which says nothing of their errors."""
    tracks = simulate_tracks(
        TrackRecipe((-6.0, 0.0, 6.0), n_points=200, outlier_share=0.0), rng=np.random.default_rng(0)
    )
    options = SfmOptions(de_generations=20)
    found = thesis_calibration(tracks.series, tracks.observations, options, rng=np.random.default_rng(0))[0]
    reconstruction = found.reconstruction
    assert reconstruction.tilt_source == "thesis"
    assert np.isnan(reconstruction.tilt_sigma_rad).all()
    assert np.isnan(reconstruction.height_scale_relative_sigma)
    assert np.isnan(reconstruction.tilt_prior_rad).all()  # no stage told any


@pytest.mark.parametrize(("rotation", "step_deg"), [([0.0, 0.1, 0.0], 5.73), ([0.01, -0.1, 0.5], -5.76)])
def test_the_tilt_is_the_turn_out_of_the_image_plane(rotation: list[float], step_deg: float) -> None:
    motion = np.array([*rotation, 0.0, 0.0])
    pair = ThesisPair(motion, motion, (1.0, 1.0), 1.0, 1, "")
    assert np.rad2deg(pair.tilt_step_rad) == pytest.approx(step_deg, abs=0.01)
