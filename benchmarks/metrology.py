"""Seconds for all figures of a 4 megapixel map, and the lateral resolution that is stated against the true one.

The map is simulated relief with holes; `cpu_seconds` is the processor time of all threads, which a busy machine
stretches less than the wall time. The resolution: the true height transmission of a reconstruction is the cross
spectrum with the truth over the truth's own, after the two are registered; half of it marks the true period limit.
"""

from __future__ import annotations

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


def measure_speed(**chosen: Any) -> dict[str, Any]:
    """Time `measure` on a map of 4 megapixels, with levelling, Monte Carlo, profile and step."""
    import numpy as np

    from semscape.metrology.grid import Region
    from semscape.metrology.measure import measure
    from semscape.metrology.request import MeasureRequest
    from semscape.options import MeasureOptions

    regions = Region(10, 10, 600, 600), Region(900, 900, 1500, 1500)
    request = MeasureRequest(MeasureOptions(**chosen), profile=(100, 100, 1800, 900), step=regions)
    height_map = _relief()
    return _timed_twice(
        lambda: (
            measure(
                height_map,
                request,
                height_scale_relative_sigma=0.01,
                window_sigma_px=3.0,
                rng=np.random.default_rng(0),
            ).figures
        )
    )


def measure_wear_speed() -> dict[str, Any]:
    """Time registration and difference of two maps of 4 megapixels, one shifted by some pixels and worn."""
    from semscape.metrology.measure import measure_change

    later, earlier = _relief(worn_um=3.0), _relief(shift=(5, 3))
    return _timed_twice(lambda: measure_change(later, earlier)[0])


def _relief(shift: tuple[int, int] = (0, 0), worn_um: float = 0.0) -> HeightMap:
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
    return HeightMap(relief, np.full(shape, 0.05), one, flat, 0.05, np.eye(4), "um")


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
    """Reconstruct a simulated series and compare the stated period limit with the true transmission."""
    import dataclasses

    import numpy as np
    from scipy import fft

    import semscape
    from semscape.metrology.register import compare
    from semscape.metrology.resolution import PERIOD_PER_SIGMA, lateral_resolution, second_differences, tapered
    from semscape.simulate import SimulationOptions, simulate

    microscope = dataclasses.replace(SimulationOptions(), width_px=_SERIES_PX, height_px=_SERIES_PX)
    series, truth = simulate(specimen, microscope, rng=1)
    height_map = semscape.reconstruct(series, rng=0).height_map
    found = height_map.height_um
    true = compare(found, truth.height_um, height_map.pixel_size_um).moved
    (bent, quiet), (bent_true, quiet_true) = second_differences(found), second_differences(true)
    weights = tapered(quiet & quiet_true)
    ours, theirs = (fft.rfft2(np.where(weights > 0, b, 0.0) * weights) for b in (bent, bent_true))
    radius = np.hypot(fft.fftfreq(found.shape[0])[:, None], fft.rfftfreq(found.shape[1])[None])
    ring = (radius * 200).astype(int)
    cross, power = (np.bincount(ring.ravel(), p.ravel()) for p in ((ours * theirs.conj()).real, np.abs(theirs) ** 2))
    transmission = cross[2:40] / power[2:40]
    frequency = (np.arange(2, 40) + 0.5) / 200
    # A Gaussian through all rings, weighted by what the truth has there, is steadier than one crossing of one half.
    sigmas = np.linspace(0.5, 12, 461)
    model = np.exp(-2 * np.pi**2 * sigmas[:, None] ** 2 * frequency**2)
    misfit = ((model - transmission) ** 2 * np.sqrt(power[2:40])).sum(axis=1)
    stated = lateral_resolution(found, 1.0)
    return {
        "stated_period_px": round(stated.period_px, 2),
        "stated_from": stated.source,
        "true_period_px": round(float(PERIOD_PER_SIGMA * sigmas[np.argmin(misfit)]), 2),
        "transmission_at_stated_period": round(float(np.interp(1 / stated.period_px, frequency, transmission)), 3),
    }


CASES: dict[str, Case] = {
    "speed": (measure_speed, ()),
    "speed-filtered": (partial(measure_speed, **_FILTERS), ()),
    "speed-sphere": (partial(measure_speed, level="sphere", **_FILTERS), ()),
    "speed-all": (partial(measure_speed, level="poly4", robust=True, outlier_sigmas=6.0, **_FILTERS), ()),
    "speed-wear": (measure_wear_speed, ()),
    "resolution-fracture": (measure_resolution, ("fracture",)),
    "resolution-pollen": (measure_resolution, ("pollen",)),
    "resolution-vickers": (measure_resolution, ("vickers",)),
}

if __name__ == "__main__":
    run_cases(CASES, "Measuring: seconds for a large map, and the stated lateral resolution against the true one.")
