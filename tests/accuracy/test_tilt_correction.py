"""A series taken with tilt correction on gives the surface of the same series without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import semscape
from semscape.io.series import load_series
from semscape.simulate import SimulationOptions, simulate
from semscape.types import FloatArray
from tilt_correction import height_scale, write_zeiss_series


def heights(folder: Path) -> FloatArray:
    return semscape.reconstruct(load_series(folder)).height_map.height_um


@pytest.mark.parametrize("axis_deg", [0, 90])
def test_undone(tmp_path: Path, axis_deg: int) -> None:
    options = replace(
        SimulationOptions(),
        axis_deg=float(axis_deg),
        tilts_deg=(-14.0, 0.0, 14.0),
        width_px=256,
        height_px=256,
        pixel_size_um=0.1,
    )
    series, _ = simulate("fracture", options=options, rng=1)
    plain = heights(write_zeiss_series(tmp_path / "plain", series, stretched=False, axis_deg=axis_deg))
    undone = heights(write_zeiss_series(tmp_path / "stretched", series, stretched=True, axis_deg=axis_deg))
    assert (np.isfinite(plain) & np.isfinite(undone)).mean() > 0.8
    scale, residual = height_scale(plain, undone)
    assert abs(scale - 1) < 0.01
    assert residual < 0.02 * np.ptp(plain[np.isfinite(plain)])
