"""Calibration of synthetic tracks of known motion: with stage tilts, from the images alone, and where it cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.errors import BadInputError, DegenerateGeometryError, TooFewMatchesError
from semscape.options import SfmOptions
from semscape.sfm.calibrate import Calibration, calibrate
from semscape.sfm.parallax import shared_points
from semscape.sfm.plausibility import require_one_axis, require_tilts
from semscape.sfm.relief import relief_vote
from semscape.types import Observations
from synthetic_tracks import PIXEL_UM, SIZE_PX, Tracks, make_tracks, relief_px

OPTIONS = SfmOptions()
TILTS = (-8.0, -4.0, 0.0, 4.0, 8.0)


def solve(tracks: Tracks, options: SfmOptions = OPTIONS, seed: int = 0) -> Calibration:
    return calibrate(tracks.series, tracks.observations, options, rng=np.random.default_rng(seed))


def true_points(found: Calibration, tracks: Tracks) -> np.ndarray:
    """Return the true point (P, 3) of each recovered one: calibration may have dropped some tracks."""
    kept = found.reconstruction.observations
    point_of = dict(zip(map(tuple, tracks.observations.xy.tolist()), tracks.observations.point.tolist(), strict=True))
    original = np.array([point_of[tuple(xy)] for xy in kept.xy.tolist()])
    first = np.unique(kept.point, return_index=True)[1]
    return tracks.points_um[original[first]]


def height_scale(found: Calibration, tracks: Tracks) -> float:
    """Return the slope of recovered against true heights, after the best plane (the common tilt) is taken out."""
    true = true_points(found, tracks)
    assert len(true) > 0.98 * len(tracks.points_um)
    design = np.column_stack([true[:, 2], true[:, :2], np.ones(len(true))])
    return float(np.linalg.lstsq(design, found.reconstruction.points_um[:, 2], rcond=None)[0][0])


@pytest.fixture(scope="module")
def staged() -> tuple[Calibration, Tracks]:
    tracks = make_tracks(TILTS, stage_deg=TILTS, seen=1.0)
    return solve(tracks), tracks


@pytest.fixture(scope="module")
def self_calibrated() -> tuple[Calibration, Tracks]:
    tracks = make_tracks(TILTS, seen=1.0)
    return solve(tracks), tracks


def test_stage_tilts_give_the_motion(staged: tuple[Calibration, Tracks]) -> None:
    found, tracks = staged[0].reconstruction, staged[1]
    error = np.rad2deg(found.motion.tilt_rad - tracks.motion.tilt_rad)
    assert np.abs(error).max() < 0.15
    assert np.ptp(error) < 0.15
    assert (np.abs(error) < 4 * np.rad2deg(found.tilt_sigma_rad)).all()
    assert np.rad2deg(found.tilt_sigma_rad).max() < 0.12
    assert np.rad2deg(found.motion.axis_angle_rad) == pytest.approx(87.0, abs=0.3)
    scale = found.motion.scale_px_per_um / found.motion.scale_px_per_um[2]
    np.testing.assert_allclose(scale, tracks.motion.scale_px_per_um / tracks.motion.scale_px_per_um[2], atol=4e-4)
    assert (found.tilt_source, found.ambiguity, found.length_unit) == ("metadata", "none", "um")
    assert found.reference == 2


def test_the_noise_is_told_as_it_is(staged: tuple[Calibration, Tracks]) -> None:
    calibration, _ = staged
    assert calibration.sigma_px == pytest.approx(0.3, rel=0.1)
    assert 1.0 <= calibration.overdispersion < 1.25
    # 2 m coordinates of a track leave 2 m - 3 free
    assert calibration.reconstruction.rms_px == pytest.approx(0.3 * np.sqrt(2 * 7 / 10), rel=0.06)


@pytest.mark.parametrize("tilts", [(-4.0, 4.0), (-8.0, 0.0, 8.0), (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)])
def test_the_noise_does_not_depend_on_the_number_of_views(tilts: tuple[float, ...]) -> None:
    found = solve(make_tracks(tilts, stage_deg=tilts, seen=1.0))
    assert found.sigma_px == pytest.approx(0.3, rel=0.1)


def test_points_are_as_good_as_they_say(staged: tuple[Calibration, Tracks]) -> None:
    calibration, tracks = staged
    found = calibration.reconstruction
    assert abs(height_scale(calibration, tracks) - 1) < 4 * found.height_scale_relative_sigma
    true = true_points(calibration, tracks)
    error = found.points_um - true
    design = np.column_stack([true, np.ones(len(error))])
    error -= design @ np.linalg.lstsq(design, error, rcond=None)[0]  # the choice of world, and the height scale
    # The theory of parallax: sigma_z = noise / (scale * root of the summed squares of sin(tilt)).
    own = 0.3 * PIXEL_UM / np.sqrt((np.sin(np.deg2rad(TILTS)) ** 2).sum())
    assert error[:, 2].std() == pytest.approx(own, rel=0.15)
    assert (found.points_sigma_um[:, 2] > 0.8 * own).all()
    assert np.sqrt(np.mean(found.points_sigma_um[:, 2] ** 2)) < 2.5 * own


def test_the_world_lies_under_the_reference_view(staged: tuple[Calibration, Tracks]) -> None:
    found = staged[0].reconstruction
    middle = (SIZE_PX - 1) / 2
    np.testing.assert_allclose(found.motion.translation_px[found.reference], middle, atol=1e-6)
    assert np.median(found.points_um[:, 2]) == pytest.approx(0, abs=1e-9)


def test_the_images_alone_give_the_motion(self_calibrated: tuple[Calibration, Tracks]) -> None:
    calibration, tracks = self_calibrated
    found = calibration.reconstruction
    assert found.tilt_source == "self-calibrated"
    assert found.ambiguity == "reflection"
    recovered = found.motion.tilt_rad - found.motion.tilt_rad[2]
    slope = float(recovered @ tracks.motion.tilt_rad / (tracks.motion.tilt_rad @ tracks.motion.tilt_rad))
    sigma = found.height_scale_relative_sigma
    assert 0.005 < sigma < 0.2
    assert abs(slope - 1) < 3 * sigma
    steps = np.diff(np.rad2deg(found.motion.tilt_rad))
    assert np.ptp(steps) < 0.25
    assert any("no stage tilt gives the sign" in warning for warning in found.warnings)


def test_shading_votes_for_the_sign(self_calibrated: tuple[Calibration, Tracks]) -> None:
    calibration, tracks = self_calibrated
    assert height_scale(calibration, tracks) > 0.7
    assert calibration.reconstruction.relief_confidence > 0.95
    dark_hills = make_tracks(TILTS, seen=1.0, shading=-1.0)
    assert height_scale(solve(dark_hills), dark_hills) < -0.7


def test_invert_relief_mirrors_everything_at_once(self_calibrated: tuple[Calibration, Tracks]) -> None:
    calibration, tracks = self_calibrated
    up, down = calibration.reconstruction, solve(tracks, replace(OPTIONS, invert_relief=True)).reconstruction
    np.testing.assert_allclose(down.motion.tilt_rad, -up.motion.tilt_rad, atol=1e-12)
    np.testing.assert_allclose(down.points_um[:, 2], -up.points_um[:, 2], atol=1e-9)
    np.testing.assert_allclose(down.points_um[:, :2], up.points_um[:, :2], atol=1e-9)
    assert down.rms_px == pytest.approx(up.rms_px)
    assert down.relief_confidence == pytest.approx(1 - up.relief_confidence)  # that the sign is right
    assert any("run again with --invert-relief" in warning for warning in up.warnings)
    assert any("against that vote" in warning and "run without it" in warning for warning in down.warnings)


def test_a_reflection_fits_as_well_and_only_the_stage_tells_it() -> None:
    """The sign of the relief is the sign of the stage's tilts."""
    true = make_tracks(TILTS, stage_deg=TILTS, seen=1.0)
    swapped = make_tracks(TILTS, stage_deg=tuple(-t for t in TILTS), seen=1.0)
    up, down = solve(true), solve(swapped)
    assert height_scale(up, true) == pytest.approx(1, abs=0.03)
    assert height_scale(down, swapped) == pytest.approx(-1, abs=0.03)
    assert down.reconstruction.rms_px == pytest.approx(up.reconstruction.rms_px, rel=0.02)
    # The stage has its way, and the shading its say.
    assert up.reconstruction.relief_confidence == 1
    assert down.reconstruction.relief_confidence < 0.02
    told = [any("shading contradicts" in text for text in found.reconstruction.warnings) for found in (up, down)]
    assert told == [False, True]


def test_the_height_scale_follows_the_stage() -> None:
    """Three views close together: the images say little of the tilts, so heights go with what the stage claims."""
    small = (-3.0, 0.0, 3.0)
    one = solve(make_tracks(small, stage_deg=small, seen=1.0)).reconstruction
    two = solve(make_tracks(small, stage_deg=(-3.3, 0.0, 3.3), seen=1.0)).reconstruction
    ratio = np.std(two.points_um[:, 2]) / np.std(one.points_um[:, 2])
    assert ratio == pytest.approx(1 / 1.1, rel=0.03)


def test_two_views_with_tilts_are_enough() -> None:
    tracks = make_tracks((-4.0, 4.0), stage_deg=(-4.0, 4.0), seen=1.0)
    found = solve(tracks)
    assert abs(height_scale(found, tracks) - 1) < 0.06
    # 0.1 deg of each tilt against their difference
    assert found.reconstruction.height_scale_relative_sigma == pytest.approx(0.1 * np.sqrt(2) / 8, rel=0.15)


@pytest.mark.parametrize("axis_deg", [0.0, 45.0, 90.0, 130.0])
def test_any_tilt_axis_is_found(axis_deg: float) -> None:
    tracks = make_tracks(TILTS, stage_deg=TILTS, axis_deg=axis_deg, seen=1.0)
    found = solve(tracks)
    assert np.rad2deg(found.reconstruction.motion.axis_angle_rad) == pytest.approx(axis_deg, abs=0.3)
    assert height_scale(found, tracks) == pytest.approx(1, abs=0.03)


def test_wrong_matches_do_not_move_the_result() -> None:
    clean = solve(make_tracks(TILTS, stage_deg=TILTS)).reconstruction
    dirty = solve(make_tracks(TILTS, stage_deg=TILTS, wrong=0.08))
    found = dirty.reconstruction
    assert np.rad2deg(np.abs(found.motion.tilt_rad - clean.motion.tilt_rad)).max() < 0.06
    assert dirty.sigma_px == pytest.approx(0.3, rel=0.15)
    assert found.rms_px < 0.5


def test_a_common_offset_of_the_stage_stays_a_common_tilt() -> None:
    """Images tell differences of tilts; where zero lies is the stage's word."""
    offset = tuple(t + 10 for t in TILTS)
    tracks = make_tracks(TILTS, stage_deg=offset, seen=1.0)
    found = solve(tracks).reconstruction
    np.testing.assert_allclose(np.diff(np.rad2deg(found.motion.tilt_rad)), 4.0, atol=0.12)
    assert np.rad2deg(found.motion.tilt_rad.mean()) == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize(
    ("told", "wrong"),
    [
        ((-8.0, -4.0, 0.0, 14.0, 8.0), {3}),  # mistyped, by far
        ((-8.0, -4.0, 0.0, 4.7, 8.0), {3}),  # and by a little
        ((-8.0, -4.0, 0.0, 4.0, 9.0), {4}),  # at the end, where it bends its neighbour too
        ((-8.0, -4.0, 0.0, 4.0, -7.9), {4}),  # wrong sign
        ((-8.0, 4.0, 0.0, -4.0, 8.0), {1, 3}),  # swapped files
        ((-7.9, -4.1, 0.1, 4.1, 8.0), set()),
    ],
)
def test_a_wrong_tilt_is_named(told: tuple[float, ...], wrong: set[int]) -> None:
    found = solve(make_tracks(TILTS, stage_deg=told, seen=1.0)).reconstruction
    assert {view for view in range(5) if any(_names(view, text) for text in found.contradictions)} == wrong
    assert bool(found.contradictions) == bool(wrong)


@pytest.mark.parametrize("relief", [0.1, 0.2])
def test_of_a_wrong_reading_the_images_say_what_is_true(relief: float) -> None:
    """A gross one bends the motion of a low relief, from which no extrapolation leads to the true tilt."""
    told = (-8.0, -4.0, 0.0, -4.5, 8.0)
    (text,) = solve(make_tracks(TILTS, stage_deg=told, seen=1.0, relief=relief)).reconstruction.contradictions
    assert _names(3, text)
    said, sigma = (float(number) for number in text.partition("other tilts say ")[2].partition(" deg")[0].split(" +- "))
    assert abs(said - 4.0) < 2 * sigma < 1.0


def _names(view: int, text: str) -> bool:
    return text.startswith(f"view_{view}.tif: the stage says") and text.endswith(
        "mistyped tilt, wrong sign or swapped files?"
    )


def test_without_a_pixel_size_lengths_are_px() -> None:
    tracks = make_tracks(TILTS, stage_deg=TILTS, pixel_size_um=np.nan, seen=1.0)
    found = solve(tracks)
    assert found.reconstruction.length_unit == "px"
    assert height_scale(found, tracks) == pytest.approx(1 / PIXEL_UM, rel=0.03)


def test_the_same_seed_gives_the_same_bytes() -> None:
    tracks = make_tracks(TILTS, stage_deg=TILTS)
    one, two = solve(tracks).reconstruction, solve(tracks).reconstruction
    np.testing.assert_array_equal(one.points_um, two.points_um)
    np.testing.assert_array_equal(one.covariance, two.covariance)
    other = solve(tracks, seed=5).reconstruction
    # The search may walk another way; the adjustment ends in the same place.
    np.testing.assert_allclose(other.motion.tilt_rad, one.motion.tilt_rad, atol=np.deg2rad(1e-4))


@pytest.mark.parametrize("stage", [True, False])
def test_stated_sigmas_hold_the_truth(stage: bool) -> None:
    """Over series with stage errors of the stated prior, errors in sigmas spread about one, not three nor a third."""
    scores = []
    for seed in range(8):
        rng = np.random.default_rng([seed, 9])
        told = tuple((np.array(TILTS) + rng.normal(0, 0.1, 5)).tolist()) if stage else None
        tracks = make_tracks(
            TILTS, stage_deg=told, seen=1.0, n_points=200, anisotropy=OPTIONS.prior_anisotropy, seed=seed
        )
        found = solve(tracks, replace(OPTIONS, de_generations=50)).reconstruction
        tilt, true = found.motion.tilt_rad, tracks.motion.tilt_rad
        span = abs(float((tilt - tilt.mean()) @ true / (true @ true)))
        scores.append((span - 1) / found.height_scale_relative_sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.7, scores
    assert abs(np.median(scores)) < 0.9, scores


# Where there is no answer


def test_two_views_without_tilts_are_refused_with_the_reason() -> None:
    tracks = make_tracks((-4.0, 4.0))
    for attempt in (lambda: solve(tracks), lambda: require_tilts(tracks.series)):
        with pytest.raises(BadInputError, match=r"bas-relief ambiguity.*--tilts"):
            attempt()


@pytest.mark.parametrize(("rotations_deg", "refused"), [((359.0, 0.0, 1.0), False), ((0.0, np.nan, 30.0), True)])
def test_a_rotated_stage_is_refused(rotations_deg: tuple[float, ...], refused: bool) -> None:
    views = tuple(
        replace(view, metadata=replace(view.metadata, stage_rotation_rad=np.deg2rad(rotation)))
        for view, rotation in zip(make_tracks((-6.0, 0.0, 6.0)).series.views, rotations_deg, strict=True)
    )
    series = replace(make_tracks((-6.0, 0.0, 6.0)).series, views=views)
    if not refused:
        require_one_axis(series)
        return
    with pytest.raises(BadInputError, match=r"view_0.tif \(0.0 deg\) and view_2.tif \(30.0 deg\)"):
        require_one_axis(series)


def test_two_views_of_which_one_has_a_tilt_are_refused() -> None:
    with pytest.raises(BadInputError, match="bas-relief"):
        solve(make_tracks((-4.0, 4.0), stage_deg=(-4.0, np.nan)))


@pytest.mark.parametrize("relief", [0.0, 0.01])
def test_a_flat_specimen_without_tilts_has_no_answer(relief: float) -> None:
    with pytest.raises(DegenerateGeometryError, match=r"no parallax.* px rms.*self-calibration is impossible.*--tilts"):
        solve(make_tracks(TILTS, relief=relief, noise_px=0.1))


def test_noise_is_no_parallax() -> None:
    """Usual keypoint noise on a flat specimen must not be taken for relief."""
    for tracks in (make_tracks(TILTS, relief=0.0, noise_px=0.4), make_tracks((0.0, 0.0, 0.0), noise_px=0.4)):
        with pytest.raises(DegenerateGeometryError, match="no parallax"):
            solve(tracks)


def test_views_of_one_tilt_have_no_answer() -> None:
    with pytest.raises(DegenerateGeometryError, match="no parallax"):
        solve(make_tracks((0.0, 0.0, 0.0), noise_px=0.05))


def test_equal_stage_tilts_have_no_answer() -> None:
    with pytest.raises(DegenerateGeometryError):
        solve(make_tracks((0.0, 0.0, 0.0), stage_deg=(2.0, 2.0, 2.0)))


def test_too_few_tracks_are_refused() -> None:
    with pytest.raises(TooFewMatchesError, match="20 tracks over 5 views, need 24"):
        solve(make_tracks(TILTS, stage_deg=TILTS, n_points=20))


@pytest.mark.filterwarnings("error")
def test_a_pixel_size_off_by_a_million_ends_in_an_error() -> None:
    """The normal matrix is then singular but for rounding, which makes variances negative."""
    tracks = make_tracks(TILTS, stage_deg=TILTS, seen=1.0)
    first = tracks.series.views[0]
    wrong = replace(first, metadata=replace(first.metadata, pixel_size_um=1e-6 * first.metadata.pixel_size_um))
    series = replace(tracks.series, views=(wrong, *tracks.series.views[1:]))
    with pytest.raises(DegenerateGeometryError, match="pixel sizes"):
        calibrate(series, tracks.observations, OPTIONS, rng=np.random.default_rng(0))


def test_invert_relief_is_refused_where_the_stage_fixes_the_sign() -> None:
    with pytest.raises(BadInputError, match="--invert-relief"):
        solve(make_tracks(TILTS, stage_deg=TILTS), replace(OPTIONS, invert_relief=True))


def test_three_views_of_small_tilts_carry_a_wide_interval_and_a_warning() -> None:
    found = solve(make_tracks((-2.0, 0.0, 2.0))).reconstruction
    assert found.height_scale_relative_sigma > 0.1
    assert any("height scale known to" in warning for warning in found.warnings)


# Parts


def test_relief_vote_tells_hills_from_pits_and_admits_ignorance() -> None:
    tracks = make_tracks()
    view = tracks.series.views[2]
    xy = np.random.default_rng(0).uniform(20, SIZE_PX - 20, (900, 2))
    height = relief_px()[np.rint(xy[:, 1]).astype(int), np.rint(xy[:, 0]).astype(int)]
    up, confidence = relief_vote(view, xy, height)
    down, _ = relief_vote(view, xy, -height)
    assert up > 0.1
    assert down == pytest.approx(-up, abs=1e-6)
    assert confidence > 0.9
    noise = np.random.default_rng(1).normal(size=len(xy))
    assert relief_vote(view, xy, noise)[1] < 0.95
    assert relief_vote(view, xy[:40], height[:40]) == (0.0, 0.5)


def test_shared_points_are_paired_by_track() -> None:
    observations = Observations(
        np.array([0, 1, 0, 2, 1, 2]), np.array([0, 0, 1, 1, 2, 2]), np.arange(12.0).reshape(6, 2)
    )
    xy1, xy2 = shared_points(observations, 0, 1)
    assert (xy1.tolist(), xy2.tolist()) == ([[0.0, 1.0]], [[2.0, 3.0]])


def test_plain_series_contradict_nothing(staged: tuple[Calibration, Tracks]) -> None:
    assert staged[0].reconstruction.contradictions == ()
    assert solve(make_tracks(TILTS)).reconstruction.contradictions == ()


def test_swapped_files_are_noticed() -> None:
    """Three views bend to tilts in the wrong order at a low residual; the anisotropies give it away."""
    found = solve(make_tracks((-6.0, 0.0, 6.0), stage_deg=(0.0, -6.0, 6.0))).reconstruction
    assert found.contradictions


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_view_that_was_turned_reverses_no_told_tilt(sign: float) -> None:
    """It pushes the axis round, and about the opposite axis told tilts would mean the mirrored relief."""
    told = tuple(sign * tilt for tilt in TILTS)
    tracks = make_tracks(TILTS, stage_deg=told, n_points=400)
    xy, turned, by = tracks.observations.xy.copy(), tracks.observations.view == 3, np.deg2rad(-25)
    turn = np.array([[np.cos(by), -np.sin(by)], [np.sin(by), np.cos(by)]])
    xy[turned] = (xy[turned] - SIZE_PX / 2) @ turn + SIZE_PX / 2
    found = solve(replace(tracks, observations=replace(tracks.observations, xy=xy))).reconstruction
    np.testing.assert_allclose(np.rad2deg(found.motion.tilt_rad), told, atol=0.5)
    assert any(text.startswith("view_3.tif: a roll of") for text in found.contradictions)


def test_a_wrong_axis_is_noticed() -> None:
    tracks = make_tracks((-6.0, 0.0, 6.0), stage_deg=(-6.0, 0.0, 6.0), axis_deg=88.0)
    views = tuple(
        replace(view, metadata=replace(view.metadata, tilt_axis_angle_rad=0.0)) for view in tracks.series.views
    )
    wrong = replace(tracks, series=replace(tracks.series, views=views))
    assert any("tilt axis is said to lie at 0.0 deg" in text for text in solve(wrong).reconstruction.contradictions)


def test_told_tilts_without_parallax_are_doubted() -> None:
    found = solve(make_tracks((0.0, 0.0, 0.0), stage_deg=(-5.0, 0.0, 5.0), noise_px=0.1)).reconstruction
    assert any("no parallax" in text for text in found.contradictions)


@pytest.mark.parametrize(("distance_um", "warned"), [(8000.0, False), (300.0, True), (np.nan, False)])
def test_a_wide_field_is_warned_of(distance_um: float, warned: bool) -> None:
    tracks = make_tracks((-6.0, 0.0, 6.0), stage_deg=(-6.0, 0.0, 6.0), n_points=200)
    views = tuple(
        replace(view, metadata=replace(view.metadata, working_distance_um=distance_um)) for view in tracks.series.views
    )
    found = solve(replace(tracks, series=replace(tracks.series, views=views))).reconstruction
    assert any("perspective" in text for text in found.warnings) == warned
