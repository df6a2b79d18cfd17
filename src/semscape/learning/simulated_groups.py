"""Groups of images to learn from that everybody can make again: simulated specimens under drawn microscopes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from semscape.errors import BadInputError
from semscape.learning.dataset import Dataset, label_group
from semscape.options import Options
from semscape.simulate import PRESETS, SPECIMENS, SimulationOptions, simulate
from semscape.types import SimulationTruth, TiltSeries

N_GROUPS = 14
_VIEWS = 4
SIZE_PX = 640
_PRESETS = ("nominal", "hard")
_STEP_DEG = (2.0, 6.0)
_SHIFT = (0.005, 0.06)


def draw_microscope(preset: str, *, rng: np.random.Generator, size_px: int = SIZE_PX) -> SimulationOptions:
    """Draw a microscope of a preset: its tilt step and how far the field moves between views."""
    step = rng.uniform(*_STEP_DEG)
    return replace(
        PRESETS[preset],
        tilts_deg=tuple(step * (i - (_VIEWS - 1) / 2) for i in range(_VIEWS)),
        shift_px=float(rng.uniform(*_SHIFT) * size_px),
        width_px=size_px,
        height_px=size_px,
    )


def simulated_group(
    number: int, seed: int, *, size_px: int = SIZE_PX, workers: int | None = None
) -> tuple[str, TiltSeries]:
    """Return the name and the series of the group of this number: the specimens in turn, nominal, then hard.

    In every second group the tilt axis is told.
    """
    return simulated_group_with_truth(number, seed, size_px=size_px, workers=workers)[:2]


def simulated_group_with_truth(
    number: int, seed: int, *, size_px: int = SIZE_PX, workers: int | None = None
) -> tuple[str, TiltSeries, SimulationTruth]:
    """Return what `simulated_group` returns, and what the series really is."""
    rng = np.random.default_rng([seed, number])
    names = tuple(SPECIMENS)
    specimen = names[number % len(names)]
    options = draw_microscope(_PRESETS[number // len(names) % len(_PRESETS)], rng=rng, size_px=size_px)
    series, truth = simulate(specimen, options, rng=int(rng.integers(2**31)), workers=workers)
    if number % 2:
        told = tuple(
            replace(view, metadata=replace(view.metadata, tilt_axis_angle_rad=math.radians(options.axis_deg)))
            for view in series.views
        )
        series = replace(series, views=told)
    return f"{specimen}-{number // len(names)}", series, truth


def simulated_dataset_parts(
    seed: int,
    options: Options,
    *,
    n_groups: int = N_GROUPS,
    every_image: bool = False,
    size_px: int = SIZE_PX,
    workers: int | None = None,
) -> Iterator[Dataset]:
    """Yield the labelled groups one after the other; a group without a match is left out."""
    for number in range(n_groups):
        name, series = simulated_group(number, seed, size_px=size_px, workers=workers)
        try:
            yield label_group(name, series, options, seed=seed, every_image=every_image)
        except BadInputError:
            continue  # under a hard microscope a smooth specimen may show nothing that matches
