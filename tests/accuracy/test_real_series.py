"""The measured tilt series, with no option: what they give, with gates on both sides.

Nobody knows the truth of these series; equal steps are what their authors very likely set. Calibration and its sparse
points tell all that is asked here; the dense stage, most of the time, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import semscape
from restarted import moved_by_restart_deg
from semscape.features.detect import detect
from semscape.options import InputOptions, Options
from semscape.sfm.calibrate import calibrate
from semscape.sfm.tracks import build_tracks
from semscape.sfm.two_view import match_pair
from semscape.types import Keypoints, Matches, Observations, Reconstruction, TiltSeries, TwoViewGeometry

pytestmark = pytest.mark.real_data
OPTIONS = Options()


@dataclass(frozen=True)
class Tracked:
    """A series up to its tracks."""

    series: TiltSeries
    keypoints: tuple[Keypoints, ...]
    matches: tuple[Matches, ...]
    geometries: tuple[TwoViewGeometry, ...]
    observations: Observations

    def calibrated(self, tilts_deg: tuple[float, ...] | None = None) -> Reconstruction:
        series = self.series
        if tilts_deg is not None:
            views = tuple(
                replace(view, metadata=replace(view.metadata, tilt_rad=float(np.deg2rad(tilt))))
                for view, tilt in zip(series.views, tilts_deg, strict=True)
            )
            series = replace(series, views=views)
        return calibrate(series, self.observations, OPTIONS.sfm, rng=np.random.default_rng(0)).reconstruction


def tracked(folder: Path) -> Tracked:
    series = semscape.load_series(folder)
    keypoints = tuple(detect(view, OPTIONS.features) for view in series.views)
    pairs = [(i, j) for i in range(series.n_views) for j in range(i + 1, series.n_views)]
    found = [
        match_pair(
            pair,
            keypoints,
            series.names,
            series.shape,
            OPTIONS.features,
            OPTIONS.robust,
            np.random.default_rng(pair),
        )
        for pair in pairs
    ]
    matches, geometries = tuple(m for m, _ in found), tuple(g for _, g in found)
    return Tracked(series, keypoints, matches, geometries, build_tracks(keypoints, matches, geometries))


@pytest.fixture(scope="module")
def quartz(shared_data: Path) -> tuple[Tracked, Reconstruction]:
    data = tracked(shared_data / "tilt_series" / "quartz")
    return data, data.calibrated()


@pytest.fixture(scope="module")
def dsa(shared_data: Path) -> tuple[Tracked, Reconstruction]:
    data = tracked(shared_data / "tilt_series" / "dsa")
    return data, data.calibrated()


@pytest.fixture(scope="module")
def pollen(shared_data: Path) -> tuple[Tracked, Reconstruction]:
    data = tracked(shared_data / "tilt_series" / "potamogeton1")
    return data, data.calibrated()


def steps_deg(found: Reconstruction) -> np.ndarray:
    steps = np.diff(np.rad2deg(found.motion.tilt_rad))
    return np.asarray(np.abs(steps)) if (np.sign(steps) == np.sign(steps[0])).all() else steps


def test_pollen_gives_steps_of_3_deg(pollen: tuple[Tracked, Reconstruction]) -> None:
    steps = steps_deg(pollen[1])
    assert len(steps) == 3
    np.testing.assert_allclose(steps, 2.95, atol=0.15)


def test_quartz_gives_equal_steps(quartz: tuple[Tracked, Reconstruction]) -> None:
    steps = steps_deg(quartz[1])
    assert abs(steps[0] - steps[1]) < 0.35
    assert 3 < steps.mean() < 7


def test_dsa_gives_equal_steps(dsa: tuple[Tracked, Reconstruction]) -> None:
    steps = steps_deg(dsa[1])
    assert abs(steps[0] - steps[1]) < 0.35
    assert 3 < steps.mean() < 7


@pytest.mark.parametrize("name", ["pollen", "quartz", "dsa"])
def test_a_restart_with_tighter_tolerance_stays(name: str, request: pytest.FixtureRequest) -> None:
    data = request.getfixturevalue(name)[0]
    assert moved_by_restart_deg(data.series, data.observations) < 0.001


def test_residuals_are_those_of_good_keypoints(quartz, dsa, pollen: tuple[Tracked, Reconstruction]) -> None:
    rms = {"quartz": quartz[1].rms_px, "dsa": dsa[1].rms_px, "pollen": pollen[1].rms_px}
    assert all(0.05 < value < 0.35 for value in rms.values()), rms


def test_the_axis_is_nearly_vertical(quartz, dsa, pollen: tuple[Tracked, Reconstruction]) -> None:
    for found in (quartz[1], dsa[1], pollen[1]):
        assert np.rad2deg(found.motion.axis_angle_rad) == pytest.approx(90, abs=8)


def test_the_axis_that_a_zeiss_header_tells_is_that_of_the_images(pollen: tuple[Tracked, Reconstruction]) -> None:
    """The evidence for reading `AP_TILT_AXIS` as a direction in the image, counter-clockwise from the horizontal."""
    header = pollen[0].series.views[0].metadata
    assert (header.raw["AP_TILT_AXIS"], header.scan_rotation_rad) == ("Tilt Axis =  90.0 °", 0.0)
    assert header.raw["DP_STAGE_TILTED"] == "Stage Tilt = in X"
    assert np.rad2deg(pollen[1].motion.axis_angle_rad) == pytest.approx(90, abs=1)


def test_dsa_has_5000_inliers_in_each_pair(dsa: tuple[Tracked, Reconstruction]) -> None:
    inliers = [int(geometry.inliers.sum()) for geometry in dsa[0].geometries]
    assert len(inliers) == 3
    assert min(inliers) >= 5000, inliers
    # Parallel projection keeps nearly all of the putative matches.
    kept = [count / len(matches) for count, matches in zip(inliers, dsa[0].matches, strict=True)]
    assert all(0.75 < share < 0.999 for share in kept), kept


def test_without_tilts_the_interval_is_wide_and_the_sign_assumed(
    quartz, dsa, pollen: tuple[Tracked, Reconstruction]
) -> None:
    for found in (quartz[1], dsa[1], pollen[1]):
        assert (found.tilt_source, found.ambiguity) == ("self-calibrated", "reflection")
        assert found.height_scale_relative_sigma > 0.02
        assert any("no stage tilt" in warning for warning in found.warnings)


def test_the_height_scale_follows_given_tilts(quartz: tuple[Tracked, Reconstruction]) -> None:
    data, _ = quartz
    one, two = data.calibrated((-5.0, 0.0, 5.0)), data.calibrated((-10.0, 0.0, 10.0))
    assert one.ambiguity == two.ambiguity == "none"
    ranges = [np.ptp(np.percentile(found.points_um[:, 2], [2, 98])) for found in (one, two)]
    tilts = [np.tan(np.ptp(found.motion.tilt_rad) / 2) for found in (one, two)]
    assert ranges[0] / ranges[1] == pytest.approx(tilts[1] / tilts[0], rel=0.05)
    assert ranges[0] / ranges[1] == pytest.approx(2.0, rel=0.15)
    assert one.height_scale_relative_sigma < 0.02


def test_the_sign_of_given_tilts_is_the_sign_of_the_relief(quartz: tuple[Tracked, Reconstruction]) -> None:
    data, _ = quartz
    up, down = data.calibrated((-5.0, 0.0, 5.0)), data.calibrated((5.0, 0.0, -5.0))
    n = min(len(up.points_um), len(down.points_um))
    assert n > 500
    assert len(up.points_um) == pytest.approx(len(down.points_um), rel=0.01)
    if len(up.points_um) == len(down.points_um):
        assert np.corrcoef(up.points_um[:, 2], down.points_um[:, 2])[0, 1] < -0.95


def test_given_tilts_through_the_door(shared_data: Path) -> None:
    options = InputOptions(tilts_deg=(-4.5, -1.5, 1.5, 4.5))
    series = semscape.load_series(shared_data / "tilt_series" / "potamogeton1", options)
    np.testing.assert_allclose(np.rad2deg(series.tilt_rad), options.tilts_deg)
    assert {view.metadata.source["tilt_rad"] for view in series.views} == {"user"}


def grain(found: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance from the image's centre and the height of every point, in px."""
    scale = float(found.motion.scale_px_per_um[found.reference])
    return np.hypot(*found.points_um[:, :2].T) * scale, found.points_um[:, 2] * scale


def test_the_pollen_grain_stands_up(pollen: tuple[Tracked, Reconstruction]) -> None:
    """The grain's middle is higher than its rim: the vote by shading got the sign right, and no hill is a pit."""
    radius, height = grain(pollen[1])
    middle, rim = height[radius < 100], height[(radius > 230) & (radius < 300)]
    assert min(len(middle), len(rim)) > 50
    assert np.median(middle) > np.median(rim) + 20


def test_pollen_is_no_perspective_that_cannot_be(pollen: tuple[Tracked, Reconstruction]) -> None:
    """Its scan's distortions look like a centre of projection beyond the grain, which stands up: see above."""
    data, options = pollen[0], replace(OPTIONS.sfm, camera="auto")
    found = calibrate(data.series, data.observations, options, rng=np.random.default_rng(0)).reconstruction
    assert found.camera == "orthographic"
    assert abs(found.camera_margin) < 10
    assert found.camera_margin < 0 or any("none that can be" in warning for warning in found.warnings)
    np.testing.assert_allclose(found.motion.tilt_rad, pollen[1].motion.tilt_rad, atol=1e-4)


def test_the_pollen_relief_is_one_of_a_grain(pollen: tuple[Tracked, Reconstruction]) -> None:
    """A relief of the order of the grain's radius; neither flat nor a needle."""
    _, height = grain(pollen[1])
    assert 100 < np.ptp(np.percentile(height, [1, 99])) < 900
    assert pollen[1].relief_confidence > 0.6


def test_tracks_are_long(pollen: tuple[Tracked, Reconstruction]) -> None:
    """A mirrored model has a good residual, too, but short tracks."""
    observations = pollen[1].observations
    assert 2.3 < len(observations.view) / observations.n_points <= 4
