"""The built-in simulated series: 5 views, +-6 deg, nominal faults, stage tilts with an error of 0.1 deg.

Gates on both sides: a result that is too good fails as well. The images cannot see a common turn of all views, nor
the height scale beyond what the stage tells (five readings of 0.1 deg over 12 deg: 1 %), so the tilts are judged
by what is left, by their stated intervals, and against the stage.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import semscape
from semscape.evaluate.height_errors import height_error, height_figures, true_units
from semscape.evaluate.motion_errors import tilt_figures
from semscape.evaluate.transmission import transmission_figures
from semscape.simulate import simulate
from semscape.types import Result, SimulationTruth


@pytest.fixture(scope="module")
def built_in() -> tuple[Result, SimulationTruth]:
    series, truth = simulate("fracture", rng=0)
    return semscape.reconstruct(series, rng=0), truth


@pytest.fixture(scope="module")
def heights(built_in: tuple[Result, SimulationTruth]) -> dict[str, Any]:
    result, truth = built_in
    motion, reference = result.reconstruction.motion, result.reconstruction.reference
    error = height_error(result.height_map, motion, reference, truth)
    return height_figures(result.height_map, error, true_units(result.height_map, truth))


def test_the_images_fix_the_tilts(built_in: tuple[Result, SimulationTruth]) -> None:
    result, truth = built_in
    figures = tilt_figures(result.reconstruction.motion, result.reconstruction.reference, truth)
    assert 0.0005 < figures["largest_tilt_error_that_images_show_deg"] < 0.05
    assert figures["tilt_rms_error_deg"] < figures["stage_tilt_rms_error_deg"]
    error = result.reconstruction.motion.tilt_rad - truth.motion.tilt_rad
    assert (np.abs(error) < 3 * result.reconstruction.tilt_sigma_rad).all()


def test_the_heights(heights: dict[str, Any]) -> None:
    assert 0.3 < heights["median_abs_error_px"] < 1.0
    assert 0.90 < heights["completeness"] <= 1.0
    assert 0.55 < heights["within_1_sigma"] < 0.80


def test_the_lateral_resolution_is_the_stated_one(built_in: tuple[Result, SimulationTruth]) -> None:
    """Half of a true wave's height is left where the run says so, from its noise and smoothness alone."""
    result, truth = built_in
    motion, reference = result.reconstruction.motion, result.reconstruction.reference
    error = height_error(result.height_map, motion, reference, truth)
    figures = transmission_figures(result.height_map, result.height_map.height_um - error.error_um)
    assert 0.75 < figures["stated_period_px"] / figures["true_period_px"] < 1.25
    assert 8 < figures["true_period_px"] < 30
