"""Views all around a dome: stage tilt combined with stage rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.errors import BadInputError
from semscape.geometry.rotations import roll_rotation, tilted_cam_from_world
from semscape.options import SfmOptions
from semscape.sfm.full_object import FullObjectModel, FullObjectMotion, calibrate_full_object
from semscape.types import Micrograph, Observations, SemMetadata, TiltSeries

VIEWS, SCALE = 12, 10.0
TILT = np.deg2rad(np.where(np.arange(VIEWS) % 2, 40.0, 30.0))
ROTATION = 2 * np.pi * np.arange(VIEWS) / VIEWS
AXIS = np.deg2rad(88.0)
RNG = np.random.default_rng(0)
TRUE = tilted_cam_from_world(AXIS, TILT, np.deg2rad(RNG.normal(0, 0.2, VIEWS))) @ roll_rotation(ROTATION)


def dome(sense: float = 1.0, rotation_error_deg: float = 0.3) -> tuple[TiltSeries, Observations, np.ndarray]:
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(400, 3))
    normals[:, 2] = np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = normals * rng.uniform(18, 22, (400, 1))
    facing = -np.einsum("vij,pj->vpi", TRUE, normals)[..., 2] > 0.35
    facing &= facing.sum(axis=0) >= 2
    point, view = np.nonzero(facing.T)
    _, point = np.unique(point, return_inverse=True)
    seen = points[facing.any(axis=0)]
    xy = SCALE * np.einsum("kij,kj->ki", TRUE[view][:, :2], seen[point]) + 400 + rng.normal(0, 0.3, (len(point), 2))
    told_tilt = TILT + np.deg2rad(rng.normal(0, 0.1, VIEWS))
    told_rotation = ROTATION + np.deg2rad(rng.normal(0, rotation_error_deg, VIEWS))
    blank = Micrograph("", np.zeros((800, 800), np.float32), np.ones((800, 800), bool))
    views = tuple(
        replace(
            blank,
            name=f"{index}.tif",
            metadata=SemMetadata(pixel_size_um=1 / SCALE, tilt_rad=float(t), stage_rotation_rad=float(sense * r)),
        )
        for index, (t, r) in enumerate(zip(told_tilt, told_rotation, strict=True))
    )
    return TiltSeries(views), Observations(view.astype(np.int64), point.astype(np.int64), xy), seen


def relative_errors_deg(found: FullObjectMotion) -> np.ndarray:
    """Return the geodesic errors of the rotations after the best common one, which no image tells."""
    u, _, vt = np.linalg.svd(np.einsum("vij,vik->jk", found.cam_from_world, TRUE))
    common = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    change = found.cam_from_world @ common @ np.swapaxes(TRUE, 1, 2)
    return np.rad2deg(np.arccos(np.clip((np.trace(change, axis1=1, axis2=2) - 1) / 2, -1, 1)))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_rotations_all_around(sense: float) -> None:
    series, observations, _ = dome(sense)
    found = calibrate_full_object(series, observations, SfmOptions())
    error = relative_errors_deg(found)
    assert 0.001 < np.sqrt(np.mean(error**2)) < 0.1  # the stage's rotation errs by 0.3
    assert np.cos(2 * (found.axis_angle_rad - AXIS)) > 0.99
    assert found.adjustment.sigma_px == pytest.approx(0.3, rel=0.1)
    assert sense * found.sense_margin > 1000
    assert not found.doubts


def test_errors_that_neighbours_share_widen_the_sigmas() -> None:
    """Half a px of smooth distortion per view, and the stated intervals of tilts and rotations still hold."""
    series, observations, _ = dome()
    alone = calibrate_full_object(series, observations, SfmOptions())
    rng = np.random.default_rng(5)
    phase, direction = rng.uniform(0, 2 * np.pi, (2, VIEWS, 2))
    x, y = (observations.xy / 200).T
    shift = np.stack(
        [
            np.cos(2 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) + start)
            for turn, start in zip(direction[observations.view].T, phase[observations.view].T, strict=True)
        ],
        axis=1,
    )
    bent = calibrate_full_object(series, replace(observations, xy=observations.xy + 0.7 * shift), SfmOptions())
    assert 1.0 <= alone.overdispersion < 1.3
    assert bent.overdispersion > 2
    known = np.sqrt(np.diag(alone.adjustment.covariance)), np.sqrt(np.diag(bent.adjustment.covariance))
    own = np.concatenate([1 + 7 * np.arange(VIEWS), 5 + 7 * np.arange(VIEWS)])
    assert (known[1][own] > known[0][own]).all()
    for found in (alone, bent):
        group = found.height_scale_relative_sigma((0, 1))
        steps = found.tilt_rad[1] - found.tilt_rad[0]
        assert abs((TILT[1] - TILT[0]) / steps - 1) < 3 * group < 0.2


def test_wrong_tracks_put_no_reading_in_doubt() -> None:
    """A view of which a tenth of the keypoints lie up to 25 px off, all to one side, says nothing against its stage."""
    series, observations, _ = dome()
    rng = np.random.default_rng(4)
    wrong = (observations.view == 5) & (rng.uniform(size=len(observations.view)) < 0.1)
    off = wrong[:, None] * np.column_stack([rng.uniform(5, 25, len(wrong)), rng.normal(0, 2, len(wrong))])
    found = calibrate_full_object(series, replace(observations, xy=observations.xy + off), SfmOptions())
    assert not found.doubts
    assert len(found.observations.view) < len(observations.view) - 0.8 * wrong.sum()
    assert len(found.adjustment.points_um) == found.observations.n_points


@pytest.mark.parametrize("told", [1.0, -1.0])
def test_the_sign_of_the_tilts_decides_the_hand(told: float) -> None:
    """The mirrored body under reversed tilts gives the same images: what is told decides, whatever the axis."""
    series, observations, true_um = dome()
    views = tuple(
        replace(view, metadata=replace(view.metadata, tilt_rad=told * view.metadata.tilt_rad)) for view in series.views
    )
    found = calibrate_full_object(replace(series, views=views), observations, SfmOptions())
    points = found.adjustment.points_um
    onto = np.linalg.lstsq(true_um - true_um.mean(axis=0), points - points.mean(axis=0), rcond=None)[0]
    assert np.linalg.det(onto) == pytest.approx(told, abs=0.05)
    assert found.adjustment.sigma_px == pytest.approx(0.3, rel=0.1)


def test_where_no_track_tells_the_sense_it_is_as_conventions_have_it() -> None:
    """Tracks within groups of one rotation alone: both senses fit alike, and that is said."""
    series, _, _ = dome()
    rotation = np.repeat(ROTATION[::3], 3)
    tilt = np.tile(np.deg2rad([30.0, 36.0, 42.0]), 4)
    rng = np.random.default_rng(3)
    cameras = tilted_cam_from_world(AXIS, tilt, np.zeros(VIEWS)) @ roll_rotation(rotation)
    point = np.repeat(np.arange(200), 3)
    view = (3 * (np.arange(200) % 4)[:, None] + np.arange(3)).ravel()
    xy = SCALE * np.einsum("kij,kj->ki", cameras[view][:, :2], rng.normal(0, 10, (200, 3))[point])
    views = tuple(
        replace(one, metadata=replace(one.metadata, tilt_rad=float(t), stage_rotation_rad=float(r)))
        for one, t, r in zip(series.views, tilt, rotation, strict=True)
    )
    observations = Observations(view, point, xy + rng.normal(400, 0.3, xy.shape))
    found = calibrate_full_object(TiltSeries(views), observations, SfmOptions())
    np.testing.assert_allclose(found.rotation_rad, rotation, atol=np.deg2rad(2))
    assert abs(found.sense_margin) < 1
    assert "seen from the electron source" in found.doubts[0]


@pytest.mark.parametrize(
    ("field", "off_deg", "what"),
    [("tilt_rad", 2.0, "tilt"), ("tilt_rad", 6.0, "tilt"), ("stage_rotation_rad", -6.0, "rotation")],
)
def test_a_reading_that_the_images_contradict_is_named(field: str, off_deg: float, what: str) -> None:
    series, observations, _ = dome()
    views = list(series.views)
    true = getattr(views[3].metadata, field)
    told = true + np.deg2rad(off_deg)
    views[3] = replace(views[3], metadata=replace(views[3].metadata, **{field: told}))
    found = calibrate_full_object(replace(series, views=tuple(views)), observations, SfmOptions())
    assert len(found.doubts) == 1
    assert found.doubts[0].startswith(f"3.tif: the stage says {np.rad2deg(told):.2f}")
    assert f"mistyped {what}" in found.doubts[0]
    said = float(found.doubts[0].partition(f"other {what}s say ")[2].partition(" ")[0])
    assert said == pytest.approx(np.rad2deg(true), abs=1.0 if what == "rotation" else 0.25)


def test_derivatives_equal_finite_differences() -> None:
    rng = np.random.default_rng(2)
    model = FullObjectModel(TILT[:3], ROTATION[:3], np.full(3, SCALE), SfmOptions())
    parameters = rng.normal(0, 0.3, 1 + 7 * 3)
    _, derivatives, _ = model.cameras(parameters)
    step = 1e-6
    for view in range(3):
        for which, index in enumerate(model.index[view, :-2]):
            up, down = parameters.copy(), parameters.copy()
            up[index] += step
            down[index] -= step
            numeric = (model.cameras(up)[0][view] - model.cameras(down)[0][view]) / (2 * step)
            np.testing.assert_allclose(derivatives[view, which], numeric, atol=1e-7)


def test_a_view_without_rotation_is_named() -> None:
    series, observations, _ = dome()
    views = list(series.views)
    views[3] = replace(views[3], metadata=replace(views[3].metadata, stage_rotation_rad=np.nan))
    with pytest.raises(BadInputError, match=r"3\.tif: .* the rotation of every view"):
        calibrate_full_object(replace(series, views=tuple(views)), observations, SfmOptions())
