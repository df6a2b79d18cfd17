from dataclasses import replace

import numpy as np
import pytest

from semscape.options import SfmOptions
from semscape.sfm.parallax import lonely_parallax
from semscape.sfm.priors import motion_prior
from semscape.types import Micrograph, Observations, SemMetadata, TiltSeries

TILTS_DEG = (-6.0, -3.0, 0.0, 3.0, 6.0)
NAMES = tuple(f"{tilt:+.0f}.tif" for tilt in TILTS_DEG)


def series_of(tilts_deg: tuple[float, ...], told: bool = True) -> TiltSeries:
    image = np.zeros((300, 300), np.float32)
    views = [
        Micrograph(
            f"{tilt:+.0f}.tif",
            image,
            image == 0,
            SemMetadata(pixel_size_um=1.0, tilt_rad=np.deg2rad(tilt) if told else float("nan")),
        )
        for tilt in tilts_deg
    ]
    return TiltSeries(tuple(views))


def seen(tilts_deg: tuple[float, ...], relief_px: float, n_points: int = 200) -> Observations:
    """Return points of a rough plane, seen with 0.5 px of noise in every view; parallax runs along y."""
    rng = np.random.default_rng(0)
    ground, height = rng.uniform(0, 300, (n_points, 2)), rng.normal(0, relief_px, n_points)
    tilt = np.deg2rad(tilts_deg)
    xy = np.repeat(ground[:, None], len(tilt), axis=1)
    xy[:, :, 1] += height[:, None] * np.sin(tilt)
    xy += rng.normal(0, 0.5, xy.shape)
    point, view = np.indices(xy.shape[:2])
    return Observations(point=point.ravel(), view=view.ravel(), xy=xy.reshape(-1, 2))


def doubts(
    tilts_deg: tuple[float, ...], observations: Observations, told: bool = True, axis_deg: float = 0.0
) -> list[str]:
    series = series_of(tilts_deg, told)
    return lonely_parallax(series, observations, motion_prior(series, SfmOptions()), np.deg2rad(axis_deg))


def given_axis(series: TiltSeries, axis_deg: float) -> TiltSeries:
    views = [
        replace(view, metadata=replace(view.metadata, tilt_axis_angle_rad=np.deg2rad(axis_deg)))
        for view in series.views
    ]
    return replace(series, views=tuple(views))


def with_wrong_matches(observations: Observations, view: int) -> Observations:
    """Return the same with 15 % of the matches of a view shifted, all alike: another place of the same look."""
    xy = observations.xy.copy()
    xy[(observations.view == view) & (observations.point % 7 == 0)] += [4.0, 3.0]
    return replace(observations, xy=xy)


def test_parallax_of_a_relief_is_believed() -> None:
    assert doubts(TILTS_DEG, seen(TILTS_DEG, relief_px=30.0)) == []


def test_parallax_that_only_the_widest_pair_shows_is_believed() -> None:
    tilts_deg = (-3.0, 0.0, 3.0)
    assert doubts(tilts_deg, seen(tilts_deg, relief_px=9.0)) == []


def test_wrong_matches_of_one_view_make_no_relief_of_a_plane() -> None:
    # They run along (4, 3), downwards: across an axis at 53 deg.
    (doubt,) = doubts(TILTS_DEG, with_wrong_matches(seen(TILTS_DEG, relief_px=0.0), view=1), axis_deg=53.0)
    assert f"parallax without support: {NAMES[1]} and {NAMES[4]} differ across the tilt axis (53 deg)" in doubt
    assert "of the 3 pairs of views tilted at least as far apart only 1 does" in doubt


def test_an_axis_that_the_parallax_does_not_cross_is_doubted() -> None:
    (doubt,) = doubts(TILTS_DEG, seen(TILTS_DEG, relief_px=30.0), axis_deg=60.0)
    assert "no two views differ across the tilt axis (60 deg) as views of a relief do" in doubt
    assert "axis given" not in doubt


def test_an_axis_that_was_given_may_be_what_is_wrong() -> None:
    series = given_axis(series_of(TILTS_DEG), 60.0)
    prior = motion_prior(series, SfmOptions())
    (doubt,) = lonely_parallax(series, seen(TILTS_DEG, relief_px=30.0), prior, np.deg2rad(60.0))
    assert "The axis given is wrong, the specimen is nearly flat where it was matched, or matches are wrong" in doubt
    assert doubt.endswith("Leave the axis out or correct it, or tilt farther")


def test_wrong_matches_beside_a_relief_do_not_matter() -> None:
    assert doubts(TILTS_DEG, with_wrong_matches(seen(TILTS_DEG, relief_px=30.0), view=1)) == []


@pytest.mark.parametrize("told", [True, False])
def test_a_plane_is_doubted_where_tilts_are_told(told: bool) -> None:
    found = doubts(TILTS_DEG, seen(TILTS_DEG, relief_px=0.0), told)
    assert [text.startswith("no parallax") for text in found] == [True] * told
