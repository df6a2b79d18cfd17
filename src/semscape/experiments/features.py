"""The thesis's comparison of SIFT, SURF, ORB and BRIEF, on a simulated series with truth and on measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from semscape.experiments.features_output import features_table
from semscape.experiments.features_table import TOLERANCE_PX, DetectorFigures, compare_features, compare_features_of
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.features.detect import DETECTORS
from semscape.options import Options, RunOptions
from semscape.report.figures import ACCENT, INK, WARM, drawn_png
from semscape.simulate import PRESETS, simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

_PRESETS = ("nominal", "hard")
_MEASURED = ("potamogeton1", "quartz", "dsa")
_QUICK_SIZE_PX = 256


def run(setting: Setting) -> Experiment:
    """Compare the four detectors on simulated series, and on the measured ones where there are any."""
    options = replace(Options(), run=RunOptions(setting.seed))
    figures: dict[str, tuple[DetectorFigures, ...]] = {}
    tables: list[Table] = []
    for preset in _PRESETS[: 1 if setting.quick else None]:
        microscope = replace(PRESETS[preset], tilts_deg=(-3.0, 0.0, 3.0))
        if setting.quick:
            microscope = replace(microscope, width_px=_QUICK_SIZE_PX, height_px=_QUICK_SIZE_PX)
        series, truth = simulate("fracture", microscope, rng=setting.seed, workers=setting.workers)
        figures[f"simulated, {preset}"] = compare_features(series, options, truth=truth)
    notes = [
        "The four share the image's normalization and the contrast of the faintest blob; they differ in the number of "
        "keypoints, so matches and inliers compare the whole method, not a keypoint.",
        "ORB's many keypoints are the same corners again at eight scales, up to the cap of features.max_keypoints.",
    ]
    for name in _MEASURED[: 1 if setting.quick else None]:
        folder = None if setting.data is None else setting.data / "tilt_series" / name
        if folder is not None and folder.is_dir():
            figures[name] = compare_features_of(folder, options)
        else:
            notes.append(f"the measured series {name} is left out: it was not given")
    for number, (name, rows) in enumerate(figures.items()):
        tables.append(features_table(rows, f"series_{number}", f"Detectors on {name}"))
    return Experiment(
        name="features",
        title="Detectors and descriptors",
        question=(
            "Which of SIFT, SURF, ORB and BRIEF gives the most matches that are right? Consecutive pairs of a series "
            "are matched by mutual nearest neighbours with the ratio test and verified a contrario. On simulated "
            f"series a match is right within {TOLERANCE_PX:g} px of where the true cameras and heights put it."
        ),
        thesis="section 2.4: the choice of the descriptor; not published here",
        tables=tuple(tables),
        figures=(_bars(figures),),
        notes=tuple(notes),
    )


def _bars(figures: dict[str, tuple[DetectorFigures, ...]]) -> Figure:
    """Draw a group of bars per series: inliers, residual, and seconds, for each detector."""
    panels: tuple[tuple[str, list[list[float | None]]], ...] = (
        ("inliers per pair", [[row.inliers for row in rows] for rows in figures.values()]),
        ("residual (px)", [[row.residual_px for row in rows] for rows in figures.values()]),
        (
            "processor seconds per view and pair",
            [[row.detect_s + row.match_s for row in rows] for rows in figures.values()],
        ),
    )
    colours = dict(zip(DETECTORS, (ACCENT, WARM, INK, "#3f9c6b"), strict=True))

    def draw(figure: Drawing) -> None:
        for axes, (label, values) in zip(figure.subplots(1, len(panels)), panels, strict=True):
            _draw_groups(axes, values, colours)
            axes.set_xticks(range(len(figures)), figures, rotation=30, ha="right")
            axes.set_ylabel(label)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=len(colours))

    return Figure(
        name="bars",
        title="Inliers, residual and time of the four detectors",
        png=drawn_png((10.0, 3.4), draw, dpi=100),
        alt="Bars for SIFT, SURF, ORB and BRIEF, grouped by series: inliers per pair, median residual, seconds.",
    )


def _draw_groups(axes: Axes, values: Sequence[Sequence[float | None]], colours: dict[str, str]) -> None:
    width = 0.8 / len(colours)
    for index, (name, colour) in enumerate(colours.items()):
        heights = np.array([group[index] for group in values], dtype=np.float64)  # None becomes NaN
        left = np.arange(len(values)) + (index - (len(colours) - 1) / 2) * width
        axes.bar(left, heights, width=0.92 * width, color=colour, label=name)
    axes.grid(axis="y", color=INK, alpha=0.25, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
