"""Shape and rotation error on faces against views, tilt step and method (thesis, section 3.8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import cycle, product
from typing import TYPE_CHECKING, Any

import numpy as np

from semscape.dense.rival import sgbm_height_map
from semscape.errors import SemscapeError
from semscape.evaluate.run import evaluate
from semscape.experiments.face_meshes import BUILT_IN, face_specimen, find_faces
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.options import Options
from semscape.pipeline import reconstruct
from semscape.report.figures import ACCENT, INK, WARM, drawn_png
from semscape.simulate import PRESETS, simulate
from semscape.types import HeightMap, Motion, Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

VIEWS = (2, 3, 5, 7, 9)
STEPS_DEG = (3.0, 6.0, 9.0, 12.0, 15.0)
# Where the other one is varied over the meshes.
_USUAL_VIEWS, _USUAL_STEP_DEG = 3, 6.0
_SIZE_PX, _QUICK_SIZE_PX = 384, 192
_THESIS = Options().with_settings(["sfm.method=thesis"])


@dataclass(frozen=True)
class Outcome:
    """What a method gives: heights, the views they come from, the one whose grid they have, and the views' names."""

    height_map: HeightMap
    motion: Motion
    reference: int
    names: tuple[str, ...]


def _default(ours: Result) -> Outcome:
    found = ours.reconstruction
    return Outcome(ours.height_map, found.motion, found.reference, ours.series.names)


def _sgbm(ours: Result) -> Outcome:
    return replace(_default(ours), height_map=sgbm_height_map(ours))


def _thesis(ours: Result) -> Outcome:
    return _default(reconstruct(ours.series, _THESIS, rng=ours.report.seed))


METHODS: dict[str, Callable[[Result], Outcome]] = {"semscape": _default, "OpenCV SGBM": _sgbm, "thesis": _thesis}
"""Each takes the result of the default pipeline; one with cameras of its own reconstructs the series in it anew.

SGBM knows no calibration; it gets that of the default pipeline, so that its heights alone are its own.
"""

_COLUMNS = (
    "face",
    "views",
    "step (deg)",
    "method",
    "rotation error (deg)",
    "stage error (deg)",
    "height scale error (%)",
    "median height error (px)",
    "height rmse (px)",
    "height rmse (% of relief)",
    "completeness at 1 px",
    "rigid: Chamfer (px)",
    "rigid: Hausdorff 95 % (px)",
    "rigid: normal angle (deg)",
    "similarity: Chamfer (px)",
    "similarity: rmse (px)",
)


def run(setting: Setting) -> Experiment:
    """Take series of every face, reconstruct them with every method, and compare with the truth."""
    faces = find_faces(setting.data)
    notes = ["One series per case: single figures scatter with the draw of the stage errors."]
    if len(faces) > 1:
        notes.append(f"Scanned heads: {_USUAL_VIEWS} views, or steps of {_USUAL_STEP_DEG:g} deg, alone.")
    else:
        notes.append("The scanned heads were not there (--data DIR with a folder meshes): left out.")
    rows: list[tuple[Any, ...]] = []
    for face, path in faces.items():
        for views, step_deg in _cases(face, quick=setting.quick):
            tilts = tuple(step_deg * (i - (views - 1) / 2) for i in range(views))
            size = _QUICK_SIZE_PX if setting.quick else _SIZE_PX
            options = replace(PRESETS["nominal"], tilts_deg=tilts, width_px=size, height_px=size)
            series, truth = simulate(
                face_specimen(face, path, options), options, rng=setting.seed, workers=setting.workers
            )
            try:
                ours = reconstruct(series, rng=setting.seed, workers=setting.workers)
            except SemscapeError as error:
                notes.append(f"{face}, {views} views, steps of {step_deg:g} deg: no result; {error}")
                rows += [(face, views, step_deg, method, *[None] * (len(_COLUMNS) - 4)) for method in METHODS]
                continue
            for method, outcome_of in METHODS.items():
                try:
                    outcome = outcome_of(ours)
                except SemscapeError as error:
                    notes.append(f"{face}, {views} views, steps of {step_deg:g} deg, {method}: no result; {error}")
                    rows.append((face, views, step_deg, method, *[None] * (len(_COLUMNS) - 4)))
                    continue
                found = evaluate(
                    outcome.height_map,
                    outcome.motion,
                    outcome.reference,
                    truth.select(tuple(series.names.index(name) for name in outcome.names)),
                    alignments=("rigid", "similarity"),
                ).figures
                rows.append((face, views, step_deg, method, *_figures(found)))
    return Experiment(
        name="faces",
        title="Faces: rotation and shape error",
        question=(
            "How far do rotation and shape depend on the number of views, the tilt step and the method? Series of "
            f"faces ({', '.join(faces)}) under the simulated microscope, preset nominal, {size} x {size} px, stage "
            "tilts known to 0.1 deg; each compared with its exact truth. Rotation error: rms geodesic angle of the "
            "rotations relative to the reference view. Heights: after taking out the lean that no image can tell, no "
            "scale fitted. SGBM is OpenCV's StereoSGBM on the widest pair up to 30 deg, with semscape's calibration. "
            "The method `thesis` takes the rotations pair by pair from the essential matrix and Differential "
            "Evolution over the reprojection error of linearly triangulated points; the surface stage is semscape's."
        ),
        thesis="section 3.8: shape and rotation error on synthetic Face models; not published here",
        tables=(
            *(_pivot(rows, method) for method in METHODS),
            Table("cases", "Every case", _COLUMNS, tuple(rows)),
        ),
        figures=(_figure(rows),),
        notes=tuple(notes),
    )


def _cases(face: str, *, quick: bool) -> Iterable[tuple[int, float]]:
    """Return (views, step): all of them for the built-in face, a row and a column for the others."""
    if quick:
        return [(2, 6.0), (3, 6.0)] if face == BUILT_IN else [(3, 6.0)]
    every = [(views, step) for views in VIEWS for step in STEPS_DEG]
    return [case for case in every if face == BUILT_IN or case[0] == _USUAL_VIEWS or case[1] == _USUAL_STEP_DEG]


def _figures(found: dict[str, Any]) -> tuple[float, ...]:
    views, heights, surface = found["views"], found["heights"], found["surface"]
    return (
        views["relative_rotation_rms_error_deg"],
        views["stage_tilt_rms_error_deg"],
        heights["height_scale_error_percent"],
        heights["median_abs_error_px"],
        heights["rmse_px"],
        heights["rmse_percent_of_relief"],
        heights["completeness_1px"],
        surface["rigid"]["chamfer_px"],
        surface["rigid"]["hausdorff_p95_px"],
        surface["rigid"]["normal_angle_mean_deg"],
        surface["similarity"]["chamfer_px"],
        surface["similarity"]["rmse_px"],
    )


def _selected(rows: list[tuple[Any, ...]], column: str, **where: Any) -> list[Any]:
    """Return a column of the rows in which the columns `face`, `views`, `method` and `step` are as given."""
    at = {"face": 0, "views": 1, "step": 2, "method": 3}
    return [row[_COLUMNS.index(column)] for row in rows if all(row[at[key]] == value for key, value in where.items())]


def _pivot(rows: list[tuple[Any, ...]], method: str) -> Table:
    """Return rotation and shape error of the built-in face by views and step, as "deg / px"."""
    steps = sorted({row[2] for row in rows})
    table = []
    for views in sorted({row[1] for row in rows}):
        cells: list[Any] = [views]
        for step in steps:
            where = {"face": BUILT_IN, "views": views, "step": step, "method": method}
            rotation, height = (
                _selected(rows, column, **where) for column in ("rotation error (deg)", "median height error (px)")
            )
            cells.append(f"{rotation[0]:.3f} / {height[0]:.2f}" if height and height[0] is not None else None)
        table.append(tuple(cells))
    return Table(
        name=f"errors_{method.replace(' ', '_').lower()}",
        title=f"{method}, built-in face: rotation error (deg) / median height error (px)",
        columns=("views", *(f"steps of {step:g} deg" for step in steps)),
        rows=tuple(table),
    )


def _figure(rows: list[tuple[Any, ...]]) -> Figure:
    faces = list(dict.fromkeys(row[0] for row in rows))
    colours = dict(zip(METHODS, (ACCENT, WARM, INK), strict=False))

    def draw(figure: Drawing) -> None:
        from matplotlib.ticker import LogLocator

        panels = figure.subplots(2, 2, sharey="row", sharex="col")
        varied: tuple[tuple[str, dict[str, float], str], ...] = (
            ("views", {"step": _USUAL_STEP_DEG}, f"views, steps of {_USUAL_STEP_DEG:g} deg"),
            ("step (deg)", {"views": _USUAL_VIEWS}, f"step (deg), {_USUAL_VIEWS} views"),
        )
        for column, (along, held, label) in enumerate(varied):
            panels[1][column].set_xlabel(label)
            for row, quantity in enumerate(("rotation error (deg)", "height rmse (% of relief)")):
                axes = panels[row][column]
                for (face, marker), method in product(zip(faces, cycle("osD^vP*X"), strict=False), METHODS):
                    if row == 0 and method == "OpenCV SGBM":
                        continue  # it has no cameras of its own
                    where: dict[str, Any] = {**held, "face": face, "method": method}
                    y = [np.nan if value is None else value for value in _selected(rows, quantity, **where)]
                    name = f"{face}, {method}" if (row, column) == (1, 0) else None
                    style: dict[str, Any] = {
                        "marker": marker,
                        "color": colours[method],
                        "linewidth": 1,
                        "markersize": 4,
                    }
                    axes.plot(_selected(rows, along, **where), y, label=name, **style)
                axes.grid(color=INK, alpha=0.25, linewidth=0.5)
                axes.spines[["top", "right"]].set_visible(False)
        for axes in panels[:, 0]:  # the methods lie decades apart
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter("")
        panels[0][0].set_ylabel("rotation error (deg)")
        panels[1][0].set_ylabel("height rmse (% of relief)")
        figure.legend(loc="outside lower center", ncols=2, fontsize=8)

    return Figure(
        name="errors",
        title="Rotation and shape error",
        png=drawn_png((8.0, 6.4), draw, dpi=100),
        alt=(
            "Rotation error and height error against the number of views (left) and the tilt step (right), for each "
            "face and method."
        ),
    )
