"""A view that does not fit is found; views that fit are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.experiments.simulated_tracks import SimulatedTracks, TrackRecipe, simulate_tracks
from semscape.options import SfmOptions
from semscape.sfm.calibrate import calibrate
from semscape.sfm.misfit import misfitting_view, without_view
from semscape.types import Observations

TILTS = (-6.0, -3.0, 0.0, 3.0, 6.0)


def spoilt(view: int, shift_px: float) -> SimulatedTracks:
    """Return a series in one view of which the specimen has bent: a wave of a shift, as charging makes it."""
    tracks = simulate_tracks(TrackRecipe(TILTS, 0.1, n_points=600), rng=np.random.default_rng(0))
    xy = tracks.observations.xy.copy()
    here = tracks.observations.view == view
    xy[here] += shift_px * np.sin(xy[here][:, ::-1] / 60.0)
    return replace(tracks, observations=replace(tracks.observations, xy=xy))


def found_in(tracks: SimulatedTracks) -> int | None:
    kept = calibrate(tracks.series, tracks.observations, SfmOptions(), rng=np.random.default_rng(0)).reconstruction
    return misfitting_view(
        tracks.series,
        tracks.observations,
        kept.observations,
        kept.residual_px,
        SfmOptions(),
        rng=np.random.default_rng(0),
    )


@pytest.mark.parametrize("view", [0, 3])
def test_a_bent_view_is_found(view: int) -> None:
    assert found_in(spoilt(view, 6.0)) == view


def test_good_views_stay() -> None:
    assert found_in(spoilt(0, 0.0)) is None


def test_a_view_is_taken_out_of_the_tracks() -> None:
    observations = Observations(
        np.array([0, 1, 2, 0, 1, 1, 2]), np.array([0, 0, 0, 1, 1, 2, 2]), np.arange(14.0).reshape(7, 2)
    )
    left = without_view(observations, 1)
    assert left.view.tolist() == [0, 1]
    assert left.point.tolist() == [0, 0]
    assert left.xy.tolist() == [[0.0, 1.0], [4.0, 5.0]]
