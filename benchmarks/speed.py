"""Seconds per stage, as they are and as multiples of OpenCV's SIFT time, and peak memory (`make benchmark`).

The unit is what `cv2.SIFT_create().detectAndCompute` takes, with OpenCV's own settings, for the same images one
after the other in the same process: a machine twice as fast halves both. Every time is the best of two runs; the
first of them also compiles what no earlier run has compiled.

`surface-*` are the surface alone, five views of 1 megapixel on all cores, as multiples of what OpenCV's StereoSGBM
takes for one pair of them in the same process.
"""

from __future__ import annotations

from typing import Any

from isolated import REAL_SETS, Case, peak_memory_mb, real_set_folder, run_cases, timed

_RUNS = 2


def measure(source: str) -> dict[str, Any]:
    """Time one series and return its row of the table."""
    import os

    import cv2
    import numpy as np

    import semscape
    from semscape.simulate import simulate

    if source in REAL_SETS:
        series, load_seconds = timed(semscape.load_series, real_set_folder(source))
    else:
        (series, _), load_seconds = timed(simulate, source, rng=0)
    stages: dict[str, float] = {}
    totals = []
    for _ in range(_RUNS):
        result, total = timed(semscape.reconstruct, series, rng=0)
        totals.append(total)
        for stage in result.report.stages:
            stages[stage.name] = min(stage.seconds, stages.get(stage.name, np.inf))
    peak = peak_memory_mb()

    images = [np.clip(view.image, 0, 255).astype(np.uint8) for view in series.views]
    sift = cv2.SIFT_create()
    unit = min(timed(lambda: [sift.detectAndCompute(image, None) for image in images])[1] for _ in range(_RUNS))
    total = min(totals)
    height, width = series.shape
    return {
        "views": series.n_views,
        "width_px": width,
        "height_px": height,
        "cores": os.cpu_count(),
        ("load_seconds" if source in REAL_SETS else "simulate_seconds"): round(load_seconds, 3),
        "opencv_sift_seconds": round(unit, 3),
        "seconds": {name: round(value, 3) for name, value in stages.items()} | {"total": round(total, 3)},
        "times_opencv_sift": {name: round(value / unit, 2) for name, value in stages.items()}
        | {"total": round(total / unit, 2)},
        "peak_memory_mb": round(peak, 1),
    }


def measure_surface(specimen: str) -> dict[str, Any]:
    """Time the surface of five views of 1 megapixel, and StereoSGBM on the widest pair, in turn."""
    import os
    import time
    from dataclasses import replace
    from types import SimpleNamespace

    from accuracy_dense import calibrated
    from semscape.cluster import local_mapper
    from semscape.dense.rival import sgbm_height_map
    from semscape.dense.tiles import surface_in_tiles
    from semscape.options import DenseOptions
    from semscape.simulate import PRESETS, simulate

    series, _ = simulate(specimen, replace(PRESETS["nominal"], width_px=1024, height_px=1024), rng=0)
    cameras = calibrated(series)
    ours, sgbm = [], []
    with local_mapper() as mapper:
        for _ in range(_RUNS + 1):  # the first compiles, or loads what is compiled
            began = time.process_time()
            found, seconds = timed(surface_in_tiles, series, cameras, DenseOptions(), mapper=mapper, threads=mapper)
            ours.append((seconds, time.process_time() - began))
            given: Any = SimpleNamespace(series=series, reconstruction=cameras, height_map=found.height_map)
            sgbm.append(timed(sgbm_height_map, given)[1])
    (seconds, processor), unit = min(ours[1:]), min(sgbm[1:])
    return {
        "views": series.n_views,
        "width_px": series.shape[1],
        "height_px": series.shape[0],
        "cores": os.cpu_count(),
        "seconds": round(seconds, 2),
        "processor_seconds": round(processor, 2),
        "opencv_sgbm_seconds": round(unit, 3),
        "times_opencv_sgbm": round(seconds / unit, 1),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


CASES: dict[str, Case] = {name: (measure, (name,)) for name in (*REAL_SETS, "fracture")}
CASES |= {f"surface-{name}": (measure_surface, (name,)) for name in ("fracture", "vickers", "grating", "pollen")}

if __name__ == "__main__":
    run_cases(CASES, "Seconds per stage and peak memory, as JSON.")
