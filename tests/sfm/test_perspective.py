"""Parallel or central projection: which one the images show, and how far away the centre is."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.experiments.simulated_tracks import TrackRecipe, simulate_tracks
from semscape.options import SfmOptions
from semscape.sfm.calibrate import calibrate
from semscape.types import Reconstruction

TILTS = (-6.0, -3.0, 0.0, 3.0, 6.0)


def solved(distance_um: float, camera: str) -> Reconstruction:
    recipe = TrackRecipe(TILTS, 0.1, n_points=600, distance_um=distance_um)
    tracks = simulate_tracks(recipe, rng=np.random.default_rng(1))
    options = SfmOptions(camera=camera)
    return calibrate(tracks.series, tracks.observations, options, rng=np.random.default_rng(0)).reconstruction


@pytest.fixture(scope="module")
def near() -> Reconstruction:
    return solved(300.0, "auto")


def test_auto_takes_the_perspective_camera_where_the_images_show_it(near: Reconstruction) -> None:
    assert near.camera == "perspective"
    assert near.camera_margin > 500
    assert abs(near.inverse_distance_per_um - 1 / 300) < 3 * near.inverse_distance_sigma_per_um
    assert any("the perspective camera is taken, for the images show it" in warning for warning in near.warnings)


def test_auto_stays_parallel_where_it_is(near: Reconstruction) -> None:
    far = solved(np.inf, "auto")
    assert (far.camera, far.inverse_distance_per_um) == ("orthographic", 0.0)
    assert -20 < far.camera_margin < 0  # the price of one parameter: the logarithm of the number of residuals
    assert far.inverse_distance_sigma_per_um < 1 / 2000


def test_the_perspective_camera_fits_better(near: Reconstruction) -> None:
    """Outliers, which parallel projection takes for noise, are judged again: the noise of the keypoints is left."""
    flat = solved(300.0, "orthographic")
    assert np.isnan(flat.camera_margin)
    assert flat.rms_px > 0.6
    assert near.rms_px == pytest.approx(0.3, abs=0.05)
    assert not near.contradictions
