"""The rectified frame: rows are epipolar lines of every pair at once, and parallax is height times g."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.dense.rectify import rectified_frame, view_from_frame_map, warp_to_frame
from semscape.dense.surface import choose_pairs
from semscape.geometry.cameras import camera_matrices
from semscape.options import SfmOptions
from semscape.sfm.calibrate import calibrate
from synthetic_tracks import make_tracks


@pytest.fixture(scope="module", params=[0.0, 40.0, 90.0])
def solved(request: pytest.FixtureRequest):
    tilts = (-8.0, 0.0, 5.0)
    tracks = make_tracks(tilts, stage_deg=tilts, axis_deg=request.param, n_points=200, seen=1.0)
    return tracks.series, calibrate(
        tracks.series, tracks.observations, SfmOptions(), rng=np.random.default_rng(0)
    ).reconstruction


def test_a_point_keeps_its_row_and_moves_by_height_times_parallax(solved) -> None:
    series, found = solved
    frame = rectified_frame(series, found)
    matrices = camera_matrices(found.motion)
    uv = []
    for index in range(series.n_views):
        xy = found.points_um @ matrices[index].T + found.motion.translation_px[index]
        affine = view_from_frame_map(index, found.motion, frame)
        uv.append(np.linalg.solve(affine[:, :2], (xy - affine[:, 2]).T).T)
    height = found.points_um[:, 2] / frame.pixel_size_um
    home = np.linalg.solve(frame.world_from_frame[:, :2], (found.points_um[:, :2] - frame.world_from_frame[:, 2]).T).T
    for index in range(series.n_views):
        np.testing.assert_allclose(uv[index][:, 1], home[:, 1], atol=1e-6)
        np.testing.assert_allclose(uv[index][:, 0], home[:, 0] + height * frame.parallax[index], atol=1e-6)
    np.testing.assert_allclose(frame.parallax, np.tan(found.motion.tilt_rad))


def test_the_frame_holds_the_field_and_is_no_mirror(solved) -> None:
    series, found = solved
    frame = rectified_frame(series, found)
    assert frame.shape[0] >= 800 * 0.98
    assert frame.shape[1] >= 800 * 0.98
    assert np.linalg.det(frame.world_from_frame[:, :2]) < 0  # v down, y up: as an image, not mirrored
    image, valid = warp_to_frame(series.views[found.reference], found.reference, found.motion, frame)
    assert image.shape == valid.shape == frame.shape
    assert valid.sum() == pytest.approx(800 * 800, rel=0.05)


def test_masked_pixels_stay_masked(solved) -> None:
    series, found = solved
    frame = rectified_frame(series, found)
    mask = series.views[1].mask.copy()
    mask[-200:] = False
    _, valid = warp_to_frame(replace(series.views[1], mask=mask), 1, found.motion, frame)
    assert valid.sum() == pytest.approx(800 * 600, rel=0.05)


def test_pairs_are_wide_few_and_hold_every_view() -> None:
    tilts = np.deg2rad([-6.0, -3.0, 0.0, 3.0, 6.0])
    chosen = choose_pairs(tilts, 6)
    assert len(chosen) == 6
    assert (0, 4) in chosen
    assert {view for pair in chosen for view in pair} == set(range(5))
    assert all(i < j for i, j in chosen)
    assert choose_pairs(np.zeros(3), 6) == []
    # Views that differ too much no longer look alike.
    assert (0, 2) not in choose_pairs(np.deg2rad([-25.0, 0.0, 25.0]), 2)


def test_pairs_of_a_wide_series_lie_about_zero_tilt_on_both_sides() -> None:
    tilts = np.deg2rad(np.arange(-60.0, 61.0, 10.0))
    wrong = np.random.default_rng(0).normal(0, np.deg2rad(0.1), len(tilts))
    for found in (choose_pairs(tilts, 4), choose_pairs(tilts + wrong, 4)):
        assert {round(np.rad2deg(tilts[j] - tilts[i])) for i, j in found} == {30}
        middle = [np.rad2deg(tilts[i] + tilts[j]) / 2 for i, j in found]
        assert min(middle) < 0 < max(middle)
        assert np.abs(np.mean(middle)) <= 10
