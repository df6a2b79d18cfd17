"""What undoing a microscope's tilt correction gives: the table of docs/files.md (`make benchmark`).

A simulated fracture is written as a Zeiss microscope does that tilts about the horizontal or the vertical axis of the
image, once as it is and once stretched by 1 / cos of the tilt across the axis. The plain series and the stretched one
are reconstructed, the latter undone as its header asks for, and left as it is. `height_scale` is the slope of heights
against those of the plain series, planes apart.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isolated import Case, run_cases

if TYPE_CHECKING:
    from semscape.types import FloatArray, TiltSeries

_TILTS_DEG = (-16.0, -8.0, 0.0, 8.0, 16.0)
_SIZE_PX = 320


def write_zeiss_series(folder: Path, series: TiltSeries, *, stretched: bool, axis_deg: int = 0) -> Path:
    """Write the views of a series whose axis is at `axis_deg`, 0 or 90, with or without tilt correction."""
    import tifffile
    from scipy.ndimage import affine_transform

    folder.mkdir()
    for view in series.views:
        reading_deg = -math.degrees(view.metadata.tilt_rad)
        image = view.image.astype(np.float64)
        if stretched:
            factor = np.ones(2)
            factor[axis_deg // 90] = math.cos(math.radians(reading_deg))
            middle = (np.array(image.shape) - 1) / 2
            image = affine_transform(image, factor, middle - middle * factor, order=3, mode="nearest")
        lines = {
            "AP_IMAGE_PIXEL_SIZE": f"Image Pixel Size = {view.metadata.pixel_size_um * 1000:.6f} nm",
            "AP_STAGE_AT_T": f"Stage at T = {reading_deg:.3f} °",
            "AP_TILT_ANGLE": f"Tilt Angle = {reading_deg:.3f} °",
            "AP_TILT_AXIS": f"Tilt Axis = {axis_deg:.1f} °",
            "DP_SCAN_ROT": "Scan Rot = Off",
            "DP_TILT_CORRECTION": f"Tilt Corrn. = {'On' if stretched else 'Off'}",
        }
        text = "".join(f"{key}\r\n{line}\r\n" for key, line in lines.items())
        pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        tags = [(34118, "s", 0, text.encode("cp1252"), True)]
        tifffile.imwrite(folder / view.name, pixels, extratags=tags, metadata=None)
    return folder


def height_scale(plain: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Return the slope of `other` against `plain` and the rms that it and a plane leave, in the maps' unit."""
    row, column = np.nonzero(np.isfinite(plain) & np.isfinite(other))
    design = np.column_stack([plain[row, column], column, row, np.ones(len(row))])
    solution = np.linalg.lstsq(design, other[row, column], rcond=None)[0]
    return float(solution[0]), float(np.std(other[row, column] - design @ solution))


def measure(axis_deg: int) -> dict[str, Any]:
    """Reconstruct the three series and return completeness and height scale of each."""
    import semscape
    from semscape.simulate import SimulationOptions, simulate

    options = replace(
        SimulationOptions(),
        axis_deg=float(axis_deg),
        tilts_deg=_TILTS_DEG,
        width_px=_SIZE_PX,
        height_px=_SIZE_PX,
        pixel_size_um=0.1,
    )
    series, _ = simulate("fracture", options=options, rng=1)
    with tempfile.TemporaryDirectory() as name:
        plain = write_zeiss_series(Path(name) / "plain", series, stretched=False, axis_deg=axis_deg)
        undone = write_zeiss_series(Path(name) / "undone", series, stretched=True, axis_deg=axis_deg)
        left = write_zeiss_series(Path(name) / "left", series, stretched=True, axis_deg=axis_deg)
        (left / "series.toml").write_text("tilt_correction_deg = 0\n")
        maps = {
            path.name: semscape.reconstruct(semscape.load_series(path)).height_map.height_um
            for path in (plain, undone, left)
        }
    return {
        name: {
            "completeness_percent": round(100 * float(np.isfinite(height).mean()), 1),
            "height_scale": round(height_scale(maps["plain"], height)[0], 4),
        }
        for name, height in maps.items()
    }


CASES: dict[str, Case] = {"tilt-correction-axis-0": (measure, (0,)), "tilt-correction-axis-90": (measure, (90,))}

if __name__ == "__main__":
    run_cases(CASES, __doc__ or "")
