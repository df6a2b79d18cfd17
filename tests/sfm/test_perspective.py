"""Parallel or central projection: which one the images show, and how far away the centre is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.experiments.simulated_tracks import TrackRecipe, simulate_tracks
from semscape.options import SfmOptions
from semscape.sfm.calibrate import calibrate
from semscape.types import Reconstruction

TILTS = (-6.0, -3.0, 0.0, 3.0, 6.0)


def solved(distance_um: float, camera: str, stage_deg: float | None = 0.1, **told: bool) -> Reconstruction:
    recipe = TrackRecipe(TILTS, stage_deg, n_points=600, distance_um=distance_um)
    tracks = simulate_tracks(recipe, rng=np.random.default_rng(1))
    options = SfmOptions(camera=camera, **told)
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


def test_auto_takes_no_camera_that_cannot_be() -> None:
    """The centre of projection beyond the specimen, as distortions of a scan may have it: refused, and why is said."""
    found = solved(-300.0, "auto")
    assert (found.camera, found.inverse_distance_per_um) == ("orthographic", 0.0)
    assert found.camera_margin > 20
    (said,) = [warning for warning in found.warnings if "none that can be" in warning]
    assert "Parallel projection is kept" in said
    assert "on the far side of the specimen" in said
    asked = solved(-300.0, "perspective")
    assert asked.camera == "perspective"
    assert asked.inverse_distance_per_um == pytest.approx(-1 / 300, rel=0.1)
    assert any("It is taken as asked for" in warning for warning in asked.warnings)


def test_the_relief_decides_on_which_side_the_centre_lies() -> None:
    """Without a stage the same images allow a near centre for one sign of the relief alone."""
    cameras = {solved(300.0, "auto", None, invert_relief=turned).camera for turned in (False, True)}
    assert cameras == {"orthographic", "perspective"}


def test_an_axis_told_the_other_way_round_is_the_same_camera() -> None:
    tracks = simulate_tracks(TrackRecipe(TILTS, 0.1, n_points=600, distance_um=300.0), rng=np.random.default_rng(1))
    told = tuple(
        replace(view, metadata=replace(view.metadata, tilt_rad=-view.metadata.tilt_rad, tilt_axis_angle_rad=-np.pi / 2))
        for view in tracks.series.views
    )
    series = replace(tracks.series, views=told)
    found = calibrate(series, tracks.observations, SfmOptions(camera="auto"), rng=np.random.default_rng(0))
    assert found.reconstruction.camera == "perspective"
    assert found.reconstruction.inverse_distance_per_um == pytest.approx(1 / 300, rel=0.1)
