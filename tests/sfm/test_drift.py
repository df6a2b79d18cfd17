"""Scan drift: found where rows explain what neighbours share, left alone where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.experiments.simulated_tracks import SimulatedTracks, TrackRecipe, simulate_tracks
from semscape.options import SfmOptions
from semscape.sfm.calibrate import Calibration, calibrate
from semscape.sfm.drift import ScanDrift
from semscape.types import Observations

TILTS = (-6.0, -3.0, 0.0, 3.0, 6.0)


def shaken(by_rows: bool) -> SimulatedTracks:
    """Return a series each view of which is bent by 0.4 px, along its rows or across them."""
    tracks = simulate_tracks(TrackRecipe(TILTS, 0.1, n_points=1500), rng=np.random.default_rng(0))
    observations = tracks.observations
    along = observations.xy[:, 1 if by_rows else 0] / 799 * np.pi
    phase = np.random.default_rng(1).uniform(0, 2 * np.pi, (len(TILTS), 2))
    shift = 0.4 * np.sin(1.5 * along[:, None] + phase[observations.view])
    return replace(tracks, observations=replace(observations, xy=observations.xy + shift))


def solved(tracks: SimulatedTracks, degree: int = 6) -> Calibration:
    options = SfmOptions(scan_drift_degree=degree)
    return calibrate(tracks.series, tracks.observations, options, rng=np.random.default_rng(0))


def test_drift_along_the_rows_is_taken_out() -> None:
    tracks = shaken(by_rows=True)
    bent, straight = solved(tracks, 0), solved(tracks)
    assert bent.overdispersion > 3
    assert straight.overdispersion < 1.5
    assert (bent.drift_px == 0).all()
    assert (straight.drift_px > 0.05).all()
    assert straight.sigma_px == pytest.approx(0.3, rel=0.1)
    assert straight.reconstruction.observations.xy.tolist()[0] in tracks.observations.xy.tolist()  # as they were seen


def test_what_rows_do_not_explain_is_left_alone() -> None:
    found = solved(shaken(by_rows=False))
    assert found.overdispersion > 3
    assert (found.drift_px == 0).all()


def test_drift_is_a_polynomial_of_the_row() -> None:
    coefficients = np.zeros((1, 2, 2))
    coefficients[0, 1, 0] = 2.0  # the second Legendre polynomial: 1 at both ends, -1/2 in the middle
    drift = ScanDrift(coefficients, 101)
    seen = Observations(np.zeros(3, np.int64), np.arange(3), np.array([[5.0, 0], [9, 50], [2, 100]]))
    np.testing.assert_allclose(drift.at(seen), [[2, 0], [-1, 0], [2, 0]])
    assert drift.rms_px[0] == pytest.approx(2 / np.sqrt(5))
