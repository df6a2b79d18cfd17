"""The rulers of the accuracy tables themselves: shapes of known size, and the oracle of what images allow."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from accuracy_shapes import STEP_SHARE, shape_figures
from height_bound import Told, oracle
from semscape.evaluate.height_errors import HeightError
from semscape.simulate import faults
from semscape.types import FloatArray

_SIDE = 120


def _result(true: FloatArray, error: FloatArray) -> HeightError:
    """Return what a height map of 1 um per pixel is compared to, the world's origin in its middle."""
    row, col = np.indices(true.shape) - (_SIDE - 1) / 2
    points = np.stack([col, -row, true], axis=-1)
    nowhere = np.full(true.shape, np.nan)
    return HeightError(error, nowhere, 1.0, nowhere, points, np.ones(true.shape, bool))


def _truth() -> Any:
    return SimpleNamespace(pixel_size_um=1.0, height_um=np.zeros((_SIDE, _SIDE)), seed=0)


def test_a_step_that_is_too_high_is_told_whatever_its_planes_lean() -> None:
    col = np.arange(_SIDE) - (_SIDE - 1) / 2
    true = np.tile(np.where(col > 0, STEP_SHARE * _SIDE, 0.0) + 0.05 * col, (_SIDE, 1))
    error = np.tile(np.where(col > 0, 0.5, 0.0) + 0.01 * col, (_SIDE, 1))
    figures = shape_figures("step", _result(true, error), _truth())
    assert figures["true_step_px"] == pytest.approx(STEP_SHARE * _SIDE)
    assert figures["step_px"] == pytest.approx(STEP_SHARE * _SIDE + 0.5, abs=1e-3)


def test_faces_of_an_indent_have_their_angle() -> None:
    turn = faults.stream(0, "specimen").uniform(0, np.pi / 2)
    row, col = np.indices((_SIDE, _SIDE)) - (_SIDE - 1) / 2
    u, v = col * np.cos(turn) - row * np.sin(turn), -col * np.sin(turn) - row * np.cos(turn)
    pyramid = np.maximum(np.abs(u), np.abs(v))
    true, found = (np.tan(np.deg2rad(90 - angle / 2)) * pyramid for angle in (136.0, 130.0))
    figures = shape_figures("vickers", _result(true, found - true), _truth())
    assert figures["true_face_angles_deg"] == pytest.approx([136.0, 136.0], abs=0.02)
    assert figures["face_angles_deg"] == pytest.approx([130.0, 130.0], abs=0.02)


def test_a_wall_that_is_smeared_over_ten_pixels_rises_over_eight() -> None:
    turn = faults.stream(0, "specimen").uniform(0, np.pi)
    row, col = np.indices((_SIDE, _SIDE)) - (_SIDE - 1) / 2
    across = col * np.cos(turn) - row * np.sin(turn)
    true = np.where(across > 0, 30.0, 0.0)
    smeared = 30.0 * np.clip(across / 10 + 0.5, 0, 1)
    figures = shape_figures("grating", _result(true, smeared - true), _truth())
    assert figures["walls_known"] == 1.0
    assert figures["wall_px_25_50_75_90_percent"][1] == pytest.approx(8.0, abs=0.3)


def test_the_oracle_averages_as_far_as_the_surface_is_smooth() -> None:
    rng = np.random.default_rng(0)
    col = np.indices((40, 40))[1] / 1.0
    noise = 3.0 * rng.standard_normal(col.shape)
    still = np.zeros(col.shape)
    errors = []
    for height in (20 * np.sin(col / 40), 20 * np.sin(col / 4)):
        told = Told(height, still, np.full(col.shape, 1 / 9), col >= 0, still, still, still, baseline=0.02)
        found = oracle(told, 1.0)(height + noise, height)
        errors.append(float(np.std(found - height)))
    gentle, rough = errors
    assert 0.1 < gentle < 0.7 * rough
    assert rough < 3.0
