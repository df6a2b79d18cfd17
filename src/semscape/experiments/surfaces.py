"""Surfaces to look at, measured and simulated, with their key figures (thesis, section 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from semscape.errors import SemscapeError
from semscape.evaluate.run import evaluate
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.io.series import load_series
from semscape.pipeline import reconstruct
from semscape.report.figures import NO_DATA, drawn_png
from semscape.report.hillshade import hillshade
from semscape.report.wording import Z_95
from semscape.simulate import PRESETS, SPECIMENS, simulate
from semscape.types import HeightMap, Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_SIZE_PX, _QUICK_SIZE_PX = 512, 192
_QUICK_SPECIMENS = ("fracture", "pollen")
_COLUMNS_OF_PANELS = 3

Named = list[tuple[str, HeightMap]]


def run(setting: Setting) -> Experiment:
    """Reconstruct measured and simulated series without any option and shade their surfaces."""
    notes: list[str] = []
    measured_rows, measured_maps = _measured(setting, notes)
    simulated_rows, simulated_maps = _simulated(setting, notes)
    figures = []
    if measured_maps:
        figures.append(_shades("measured", "Measured series", measured_maps))
    figures.append(_shades("simulated", "Simulated series", simulated_maps))
    tables = (
        Table(
            "measured",
            "Measured series, nothing but the images given",
            (
                "series", "views", "size (px)", "tilts (deg)", "height scale, 95 % (%)", "residual rms (px)", "points",
                "completeness (%)", "height range", "unit", "median uncertainty (px)",
            ),
            tuple(measured_rows),
            "Nobody knows the truth of these. Completeness is of the whole field, bare support included.",
        ),
        Table(
            "simulated",
            "Simulated series, preset nominal, five views from -6 to +6 deg, against their truth",
            (
                "specimen", "relief (px)", "rotation error (deg)", "height scale error (%)",
                "height scale error of the tilts (%)", "median height error (px)", "height rmse (% of relief)",
                "normal angle, median (deg)", "rigid: Chamfer (px)", "completeness (%)", "completeness at 1 px (%)",
            ),
            tuple(simulated_rows),
            "The height scale error is the slope of the heights over the true ones. What it has beyond that of the "
            "tilts, the surface stage lost: it rounds walls and fills grooves, and a surface that is nothing else, "
            "like the grating's or the scratches', is too low by the slope although its tilts are right.",
        ),
    )  # fmt: skip
    return Experiment(
        name="surfaces",
        title="Surfaces: what comes out",
        question=(
            "What do the surfaces look like? Measured and simulated series, reconstructed with the defaults, shaded "
            "with light from the upper left; light blue is unknown."
        ),
        thesis="section 3.4: qualitative surfaces; not published here",
        tables=tables if measured_rows else tables[1:],
        figures=tuple(figures),
        notes=tuple(notes),
    )


def _measured(setting: Setting, notes: list[str]) -> tuple[list[tuple[Any, ...]], Named]:
    folder = None if setting.data is None else setting.data / "tilt_series"
    if folder is None or not folder.is_dir():
        notes.append("The measured series were not there (--data DIR with a folder tilt_series): left out.")
        return [], []
    if setting.quick:
        notes.append("A quick run leaves the measured series out.")
        return [], []
    rows, maps = [], []
    for path in sorted(item for item in folder.iterdir() if item.is_dir()):
        try:
            result = reconstruct(load_series(path), rng=setting.seed, workers=setting.workers)
        except SemscapeError as error:
            notes.append(f"{path.name}: no result; {error}")
            continue
        rows.append(_measured_row(path, result))
        maps.append((path.name, result.height_map))
    return rows, maps


def _measured_row(path: Path, result: Result) -> tuple[Any, ...]:
    found, height_map = result.reconstruction, result.height_map
    rows, cols = result.series.shape
    tilts = ", ".join(f"{tilt:.2f}" for tilt in np.rad2deg(found.motion.tilt_rad))
    return (
        path.name,
        result.series.n_views,
        f"{cols} x {rows}",
        tilts,
        100 * Z_95 * found.height_scale_relative_sigma,
        found.rms_px,
        len(found.points_um),
        100 * float(np.isfinite(height_map.height_um).mean()),
        float(result.report.metrics["height_range"]),
        height_map.length_unit,
        float(np.nanmedian(height_map.uncertainty_um)) / height_map.pixel_size_um,
    )


def _simulated(setting: Setting, notes: list[str]) -> tuple[list[tuple[Any, ...]], Named]:
    size = _QUICK_SIZE_PX if setting.quick else _SIZE_PX
    options = replace(PRESETS["nominal"], width_px=size, height_px=size)
    rows, maps = [], []
    for specimen in _QUICK_SPECIMENS if setting.quick else SPECIMENS:
        series, truth = simulate(specimen, options, rng=setting.seed, workers=setting.workers)
        try:
            result = reconstruct(series, rng=setting.seed, workers=setting.workers)
        except SemscapeError as error:
            notes.append(f"{specimen}: no result; {error}")
            rows.append((specimen, *[None] * 10))
            continue
        truth = truth.select(tuple(series.names.index(name) for name in result.series.names))
        cameras = result.reconstruction.motion, result.reconstruction.reference
        found = evaluate(result.height_map, *cameras, truth, mesh=result.mesh, alignments=("rigid",)).figures
        heights = found["heights"]
        rows.append(
            (
                specimen,
                found["relief_um"] / found["pixel_size_um"],
                found["views"]["relative_rotation_rms_error_deg"],
                heights["height_scale_error_percent"],
                found["views"]["height_scale_error_of_tilts_percent"],
                heights["median_abs_error_px"],
                heights["rmse_percent_of_relief"],
                heights["normal_angle_median_deg"],
                found["surface"]["rigid"]["chamfer_px"],
                100 * heights["completeness"],
                100 * heights["completeness_1px"],
            )
        )
        maps.append((specimen, result.height_map))
    return rows, maps


def _shades(name: str, title: str, maps: Sequence[tuple[str, HeightMap]]) -> Figure:
    across = min(_COLUMNS_OF_PANELS, len(maps))
    down = -(-len(maps) // across)

    def draw(figure: Drawing) -> None:
        panels = figure.subplots(down, across, squeeze=False).ravel()
        for axes in panels:
            axes.set_axis_off()
        for axes, (label, height_map) in zip(panels, maps, strict=False):
            shade = hillshade(height_map.height_um, height_map.pixel_size_um)
            axes.imshow(np.broadcast_to(NO_DATA, (1, 1, 4)), extent=(0, 1, 0, 1), transform=axes.transAxes)
            axes.imshow(np.ma.masked_invalid(shade), cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
            axes.set_title(label, fontsize=9)

    return Figure(
        name=name,
        title=title,
        png=drawn_png((2.7 * across, 2.95 * down), draw, dpi=110, colours=64),
        alt=f"Shaded surfaces of {', '.join(label for label, _ in maps)}, lit from the upper left.",
    )
