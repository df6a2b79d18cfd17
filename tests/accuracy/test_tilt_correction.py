"""A series taken with tilt correction on gives the surface of the same series without it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
from scipy.ndimage import affine_transform

import semscape
from semscape.io.series import load_series
from semscape.simulate import SimulationOptions, simulate
from semscape.types import FloatArray, TiltSeries


def write_series(folder: Path, series: TiltSeries, *, stretched: bool) -> Path:
    """Write the views as a Zeiss microscope does that tilts about the horizontal axis."""
    folder.mkdir()
    for view in series.views:
        reading_deg = -math.degrees(view.metadata.tilt_rad)
        image = view.image.astype(np.float64)
        if stretched:
            factor, middle = math.cos(math.radians(reading_deg)), (image.shape[0] - 1) / 2
            image = affine_transform(image, (factor, 1.0), (middle - middle * factor, 0.0), order=3, mode="nearest")
        lines = {
            "AP_IMAGE_PIXEL_SIZE": f"Image Pixel Size = {view.metadata.pixel_size_um * 1000:.6f} nm",
            "AP_STAGE_AT_T": f"Stage at T = {reading_deg:.3f} °",
            "AP_TILT_ANGLE": f"Tilt Angle = {reading_deg:.3f} °",
            "AP_TILT_AXIS": "Tilt Axis = 0.0 °",
            "DP_SCAN_ROT": "Scan Rot = Off",
            "DP_TILT_CORRECTION": f"Tilt Corrn. = {'On' if stretched else 'Off'}",
        }
        text = "".join(f"{key}\r\n{line}\r\n" for key, line in lines.items())
        pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        tags = [(34118, "s", 0, text.encode("cp1252"), True)]
        tifffile.imwrite(folder / view.name, pixels, extratags=tags, metadata=None)
    return folder


def heights(folder: Path) -> FloatArray:
    return semscape.reconstruct(load_series(folder)).height_map.height_um


def test_undone(tmp_path: Path) -> None:
    options = replace(
        SimulationOptions(), axis_deg=0.0, tilts_deg=(-14.0, 0.0, 14.0), width_px=256, height_px=256, pixel_size_um=0.1
    )
    series, _ = simulate("fracture", options=options, rng=1)
    plain = heights(write_series(tmp_path / "plain", series, stretched=False))
    undone = heights(write_series(tmp_path / "stretched", series, stretched=True))
    both = np.isfinite(plain) & np.isfinite(undone)
    assert both.mean() > 0.8
    row, column = np.nonzero(both)
    design = np.column_stack([plain[both], column, row, np.ones(len(row))])
    (scale, *_), residual, *_ = np.linalg.lstsq(design, undone[both], rcond=None)
    assert abs(scale - 1) < 0.01
    assert math.sqrt(float(residual[0]) / len(row)) < 0.02 * np.ptp(plain[both])
