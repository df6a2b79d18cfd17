"""Seconds for all figures of a 4 megapixel map, and the lateral resolution that is stated against the true one.

The map is simulated relief with holes; `cpu_seconds` is the processor time of all threads, which a busy machine
stretches less than the wall time. The resolution: the period at which a reconstruction of a simulated series holds half
of a true wave's height, against the one that the run states.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from isolated import Case, peak_memory_mb, run_cases, timed

if TYPE_CHECKING:
    from semscape.types import HeightMap

_SIZE_PX = 2048
_FILTERS = {"s_filter_um": 1.0, "l_filter_um": 20.0}
_SERIES_PX = 448


def measure_speed(lateral_period_px: float = 16.0, **chosen: Any) -> dict[str, Any]:
    """Time `measure` on a map of 4 megapixels, with levelling, Monte Carlo, profile and step."""
    import numpy as np

    from semscape.metrology.grid import Region
    from semscape.metrology.measure import measure
    from semscape.metrology.request import MeasureRequest
    from semscape.options import MeasureOptions

    regions = Region(10, 10, 600, 600), Region(900, 900, 1500, 1500)
    request = MeasureRequest(MeasureOptions(**chosen), profile=(100, 100, 1800, 900), step=regions)
    height_map = _relief(lateral_period_px=lateral_period_px)
    return _timed_twice(
        lambda: (
            measure(
                height_map,
                request,
                height_scale_relative_sigma=0.01,
                rng=np.random.default_rng(0),
            ).figures
        )
    )


def measure_wear_speed() -> dict[str, Any]:
    """Time registration and difference of two maps of 4 megapixels, one shifted by some pixels and worn."""
    from semscape.metrology.measure import measure_change

    later, earlier = _relief(worn_um=3.0), _relief(shift=(5, 3))
    return _timed_twice(lambda: measure_change(later, earlier)[0])


def _relief(shift: tuple[int, int] = (0, 0), worn_um: float = 0.0, lateral_period_px: float = math.nan) -> HeightMap:
    import numpy as np
    from scipy import ndimage

    from semscape.types import HeightMap

    rng = np.random.default_rng(0)
    shape = (_SIZE_PX, _SIZE_PX)
    relief = sum(s * ndimage.gaussian_filter(rng.normal(size=shape), s, mode="wrap") for s in (3.0, 12.0, 40.0))
    relief = np.roll(relief, shift, (0, 1))
    relief[rng.random((64, 64)).repeat(32, 0).repeat(32, 1) < 0.05] = np.nan
    relief[500:600, 500:700] -= worn_um
    one, flat = np.ones(shape, np.uint8), np.zeros(shape, np.float32)
    period = np.full(shape, 0.05 * lateral_period_px, np.float32)
    return HeightMap(relief, np.full(shape, 0.05), one, flat, 0.05, np.eye(4), "um", lateral_period_um=period)


def _timed_twice(figures: Callable[[], tuple[Any, ...]]) -> dict[str, Any]:
    best, cpu, found = float("inf"), float("inf"), ()
    for _ in range(2):
        started = time.process_time()
        found, seconds = timed(figures)
        best, cpu = min(best, seconds), min(cpu, time.process_time() - started)
    return {
        "megapixels": round(_SIZE_PX**2 / 1e6, 2),
        "figures": len(found),
        "seconds": round(best, 2),
        "cpu_seconds": round(cpu, 2),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


def measure_resolution(specimen: str) -> dict[str, Any]:
    """Reconstruct a simulated series and compare the stated period limit with the true one."""
    import dataclasses

    import semscape
    from semscape.evaluate.height_errors import height_error
    from semscape.evaluate.transmission import transmission_figures
    from semscape.simulate import SimulationOptions, simulate

    microscope = dataclasses.replace(SimulationOptions(), width_px=_SERIES_PX, height_px=_SERIES_PX)
    series, truth = simulate(specimen, microscope, rng=1)
    found = semscape.reconstruct(series, rng=0)
    motion, reference = found.reconstruction.motion, found.reconstruction.reference
    error = height_error(found.height_map, motion, reference, truth)
    return transmission_figures(found.height_map, found.height_map.height_um - error.error_um)


CASES: dict[str, Case] = {
    "speed": (measure_speed, ()),
    "speed-filtered": (partial(measure_speed, **_FILTERS), ()),
    "speed-sphere": (partial(measure_speed, level="sphere", **_FILTERS), ()),
    "speed-all": (partial(measure_speed, level="poly4", robust=True, outlier_sigmas=6.0, **_FILTERS), ()),
    "speed-all-fine": (
        partial(measure_speed, 2.0, level="poly4", robust=True, outlier_sigmas=6.0, **_FILTERS),
        (),
    ),
    "speed-fine": (partial(measure_speed, 2.0), ()),
    "speed-wear": (measure_wear_speed, ()),
    "resolution-fracture": (measure_resolution, ("fracture",)),
    "resolution-pollen": (measure_resolution, ("pollen",)),
    "resolution-vickers": (measure_resolution, ("vickers",)),
}

if __name__ == "__main__":
    run_cases(CASES, "Measuring: seconds for a large map, and the stated lateral resolution against the true one.")
