"""Groups of images to learn from that everybody can make again: simulated specimens under drawn microscopes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from semscape.learning.dataset import Dataset, label_group
from semscape.options import Options
from semscape.simulate import PRESETS, SPECIMENS, SimulationOptions, simulate
from semscape.types import TiltSeries

N_GROUPS = 14
_VIEWS = 4
_SIZE_PX = 640
# Faults of a size that is drawn between those of the presets "nominal" and "hard", evenly in the logarithm.
_DRAWN = (
    "blur_px", "dose", "line_noise", "jitter_px", "drift_px", "charging", "brightness", "contrast", "texture",
    "texture_bump",
)  # fmt: skip
_STEP_DEG = (2.0, 6.0)
_LARGEST_SHIFT = 0.06


def draw_microscope(rng: np.random.Generator, size_px: int = _SIZE_PX) -> SimulationOptions:
    """Draw a microscope between `nominal` and `hard`: its faults, tilt step, shifts; the axis is vertical."""
    nominal, hard = PRESETS["nominal"], PRESETS["hard"]
    faults = {}
    for name in _DRAWN:
        low, high = math.log(getattr(nominal, name)), math.log(getattr(hard, name))
        faults[name] = math.exp(low + rng.uniform() * (high - low))
    step = rng.uniform(*_STEP_DEG)
    return replace(
        nominal,
        **faults,
        tilts_deg=tuple(step * (i - (_VIEWS - 1) / 2) for i in range(_VIEWS)),
        shift_px=float(rng.uniform(0.005, _LARGEST_SHIFT) * size_px),
        width_px=size_px,
        height_px=size_px,
    )


def simulated_group(number: int, seed: int, *, size_px: int = _SIZE_PX, workers: int | None = None) -> tuple[
    str, TiltSeries
]:
    """Return the name and the series of the group of this number: the specimens in turn, then once more.

    In every second group the tilt axis is told.
    """
    rng = np.random.default_rng([seed, number])
    names = tuple(SPECIMENS)
    specimen = names[number % len(names)]
    options = draw_microscope(rng, size_px)
    series, _ = simulate(specimen, options, rng=int(rng.integers(2**31)), workers=workers)
    if number % 2:
        told = tuple(
            replace(view, metadata=replace(view.metadata, tilt_axis_angle_rad=math.radians(options.axis_deg)))
            for view in series.views
        )
        series = replace(series, views=told)
    return f"{specimen}-{number // len(names)}", series


def simulated_dataset_parts(
    seed: int, options: Options, *, n_groups: int = N_GROUPS, size_px: int = _SIZE_PX, workers: int | None = None
) -> Iterator[Dataset]:
    """Yield the labelled groups one after the other, every image labelled."""
    for number in range(n_groups):
        name, series = simulated_group(number, seed, size_px=size_px, workers=workers)
        yield label_group(name, series, options, seed=seed, every_image=True)
