"""Time and memory of every stage from 0.25 to 36 megapixels, as JSON: `python benchmarks/dense_scaling.py [NAME ...]`.

The series are wavy sheets with texture at all scales, whose relief is 5 % of their field, seen at -6, 0 and 6 deg; they
are made by warping, because that is quick at any size. `cpu_seconds` do not depend on what else the machine does,
`seconds` do. Keypoints are limited to 20,000 per view: more of them would make no better motion, and matching them all
grows as the square of their number. `dense_cpu_seconds_per_megapixel` is flat where time is linear.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from isolated import Case, run_cases

if TYPE_CHECKING:
    from semscape.types import FloatArray, ImageArray, TiltSeries

_TILTS_DEG = (-6.0, 0.0, 6.0)
_RELIEF = 0.05
_KEYPOINTS = 20_000
_NOISE = 4.0


def wide_series(side_px: int, tilts_deg: tuple[float, ...]) -> tuple[TiltSeries, ImageArray]:
    """Return a series of `side_px` squared with its true heights in px."""
    import cv2
    import numpy as np

    from semscape.types import Micrograph, SemMetadata, TiltSeries

    rng = np.random.default_rng(side_px)

    def waves(wavelength_px: float) -> ImageArray:
        cells = int(np.ceil(side_px / wavelength_px)) + 3
        coarse = rng.standard_normal((cells, cells), dtype=np.float32)
        return np.asarray(cv2.resize(coarse, (side_px, side_px), interpolation=cv2.INTER_CUBIC), np.float32)

    height = waves(side_px / 6) + 0.1 * waves(side_px / 40)
    height *= _RELIEF * side_px / float(np.ptp(height))
    texture = np.zeros_like(height)
    for wavelength_px in (2.0, 4.0, 8.0, 16.0, 64.0):
        texture += waves(wavelength_px)
    x, y = (axis.astype(np.float32) for axis in np.meshgrid(np.arange(side_px), np.arange(side_px)))
    centre = (side_px - 1) / 2
    views = []
    for index, tilt in enumerate(np.deg2rad(tilts_deg)):
        column = x
        for _ in range(5):
            shift = cv2.remap(height, column, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) * np.sin(tilt)
            column = ((x - centre - shift) / np.cos(tilt) + centre).astype(np.float32)
        image = 128 + 18 * cv2.remap(texture, column, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        image += rng.standard_normal(image.shape, dtype=np.float32) * np.float32(_NOISE)
        mask = (column > 0) & (column < side_px - 1)
        metadata = SemMetadata(pixel_size_um=1.0, tilt_rad=float(tilt))
        views.append(Micrograph(f"{index}.tif", np.clip(image, 0, 255).astype(np.float32), mask, metadata))
    return TiltSeries(tuple(views)), height


def measure(side_px: int, tilts_deg: tuple[float, ...]) -> dict[str, Any]:
    """Reconstruct a series, write its run folder, and return its row of the table."""
    import os
    import tempfile

    import numpy as np

    import semscape
    from semscape.options import Options
    from semscape.report.memory import PeakMemory
    from semscape.report.run import write_run

    series, height = wide_series(side_px, tilts_deg)
    options = Options().with_settings([f"features.max_keypoints={_KEYPOINTS}"])
    started: dict[str, float] = {}
    cpu: dict[str, float] = {}

    def follow(stage: str, figures: dict[str, Any] | None) -> None:
        if figures is None:
            started[stage] = time.process_time()
        else:
            cpu[stage] = time.process_time() - started[stage]

    result = semscape.reconstruct(series, options, rng=0, progress=follow)
    seconds = {stage.name: stage.seconds for stage in result.report.stages}
    memory = {stage.name: stage.peak_memory_mb for stage in result.report.stages}
    peak, began, began_cpu = PeakMemory(), time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_run(result, folder)
    seconds["report"], cpu["report"] = time.perf_counter() - began, time.process_time() - began_cpu
    memory["report"] = peak.peak_mb()
    found: FloatArray = result.height_map.height_um
    error = found - height
    megapixels = side_px**2 / 1e6
    return {
        "megapixels": round(megapixels, 2),
        "views": len(tilts_deg),
        "cores": os.cpu_count(),
        "seconds": {name: round(value, 1) for name, value in seconds.items()},
        "cpu_seconds": {name: round(value, 1) for name, value in cpu.items()},
        "peak_memory_mb": {name: round(value) for name, value in memory.items()},
        "dense_cpu_seconds_per_megapixel": round(cpu["surface"] / megapixels, 2),
        "most_memory_mb": round(max(memory.values())),
        "completeness": round(float(np.isfinite(found).mean()), 4),
        "median_height_error_px": round(float(np.nanmedian(np.abs(error - np.nanmedian(error)))), 3),
    }


_FIVE = (-6.0, -3.0, 0.0, 3.0, 6.0)
CASES: dict[str, Case] = {
    **{f"{side}": (measure, (side, _TILTS_DEG)) for side in (512, 1024, 2048, 3072, 4096, 6144)},
    "2048-five-views": (measure, (2048, _FIVE)),
}

if __name__ == "__main__":
    run_cases(CASES, "Time and memory from 0.25 to 36 megapixels, as JSON.")
