"""Write the tables of docs/motion.md from the JSON of benchmarks/motion.py.

`python benchmarks/motion_tables.py FILE ...` prints the page; several files are joined, so that cases may be run apart.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

_HEAD = """# Motion: tables

Made by `make motion`, which runs `benchmarks/motion.py`. What is measured and why: [method.md](method.md), sections 5
to 8.
"""


def page(rows: dict[str, Any]) -> str:
    """Return the page for the cases that are there."""
    told = [row for row in rows.values() if "anisotropy_told" in row]
    series = {case: row for case, row in rows.items() if "series_for_coverage" in row}
    rivals = {case: row for case, row in rows.items() if case.startswith("adjustment-rivals")}
    real = {case: row for case, row in rows.items() if "steps_sd_over_bootstraps_deg" in row}
    parts = [_HEAD]
    if series:
        parts.append(_accuracy(series))
    if told:
        parts.append(_told_scan(told))
    if "convergence" in rows:
        parts.append(_convergence(rows["convergence"]))
    if "objective" in rows:
        parts.append(_objective(rows["objective"]))
    if "adjustment" in rows:
        row = rows["adjustment"]
        parts.append(
            f"## Bundle adjustment alone\n\n{row['views']} views of {row['points']:,} points: "
            f"{row['processor_seconds']} s of one core, {row['peak_memory_mb']:.0f} MB.\n"
        )
    parts += [_rivals(row) for row in rivals.values()]
    if real:
        parts.append(_real(real))
    return "\n".join(parts)


def _accuracy(rows: dict[str, Any]) -> str:
    keys = {
        "series": "series",
        "tilt_step_rms_error_deg": "steps, rms error (deg)",
        "tilt_rms_error_deg": "tilts (deg)",
        "stage_tilt_rms_error_deg": "stage's own (deg)",
        "height_scale_rms_error_percent": "height scale, rms error (%)",
        "height_scale_median_error_percent": "median (%)",
        "stage_scale_rms_error_percent": "stage's own, rms (%)",
        "height_scale_stated_sigma_percent": "stated 1 sigma (%)",
        "tilts_in_95_percent": "tilts in 95 % (%)",
        "steps_in_95_percent": "steps (%)",
        "height_scale_in_95_percent": "height scale (%)",
    }
    return (
        "## Tilts recovered against tilts set\n\n"
        "2000 tracks, 0.3 px noise, 10 % of the observations wrong, scale drift 0.1 %, roll 0.2 deg; steps of 3 deg "
        "(3 views: 6 deg; 7 views over 12 deg: 2 deg); stage readings err by 0.1 deg; anisotropy 0.1 % where named. "
        "The last columns: how many of the stated 95 % intervals hold the truth, over so many series of so many "
        "tracks, and the errors there.\n\n"
        + _table(
            ["case", *keys.values(), "coverage over", "there: height scale, rms (%)", "stage's own (%)"],
            (
                [
                    case,
                    *(row[key] for key in keys),
                    f"{row['series_for_coverage']} series, {row['tracks_for_coverage']} tracks",
                    row["height_scale_rms_error_percent_of_many"],
                    row["stage_scale_rms_error_percent_of_many"],
                ]
                for case, row in rows.items()
            ),
        )
    )


def _told_scan(rows: list[dict[str, Any]]) -> str:
    body = [
        [
            row["views"],
            f"{100 * row['anisotropy_told']:g} %",
            "drawn" if row["anisotropy_true"] is None else f"{100 * row['anisotropy_true']:g} %",
            *(row[key] for key in ("height_scale_rms_error_percent", "height_scale_stated_sigma_percent")),
            *(row[key] for key in ("tilts_in_95_percent", "height_scale_in_95_percent")),
        ]
        for row in rows
    ]
    return (
        f"## What is told of the scan, and what it is\n\n{rows[0]['series']} series each of 400 tracks, images alone; "
        "anisotropy of the scan as told (`sfm.prior_anisotropy`) and as it is, 1 sigma; drawn: every series has a scan "
        "of its own, from what may be when so much is told (method.md, section 5).\n\n"
        + _table(
            [
                "views",
                "told",
                "true",
                "height scale, rms error (%)",
                "stated 1 sigma (%)",
                "tilts in 95 % (%)",
                "height scale (%)",
            ],
            body,
        )
    )


def _convergence(row: dict[str, Any]) -> str:
    head = [name.removesuffix("_median").replace("_", " ") for name in row["columns"]]
    return (
        "## Where searches and refinements end\n\n5 views 3 deg apart, 2000 tracks, 30 seeds each; medians. "
        f"{row['note']}\n\n" + _table(head, row["rows"])
    )


def _objective(row: dict[str, Any]) -> str:
    rates, seconds = row["evaluations_per_processor_second_by_tracks"], row["preparation_processor_seconds_by_tracks"]
    return f"## The objective, {row['views']} views\n\nSeconds of one core.\n\n" + _table(
        ["tracks", "evaluations per second", "preparation, once (s)"],
        ([f"{int(tracks):,}", f"{rate:,}", seconds[tracks]] for tracks, rate in rates.items()),
    )


def _rivals(row: dict[str, Any]) -> str:
    methods = {name: figures for name, figures in row.items() if isinstance(figures, dict)}
    keys = {
        "seconds": "seconds",
        "iterations": "iterations",
        "tilt_step_rms_error_deg": "steps, rms error (deg)",
        "rms_difference_of_steps_to_semscape_deg": "steps against semscape's, rms (deg)",
        "peak_memory_mb": "peak memory so far (MB)",
        "status": "end",
    }
    return (
        f"## Bundle adjustment, {row['views']} views of {row['points']:,} points\n\n"
        "One after the other in one run, from the same start. COLMAP knows no parallel projection and no priors: "
        "pinholes from 10 m take its place, on the images alone.\n\n"
        + _table(["method", *keys.values()], ([n, *(m.get(key) for key in keys)] for n, m in methods.items()))
    )


def _real(rows: dict[str, Any]) -> str:
    body = [
        [
            case,
            row["tracks"],
            _list(row["tilt_steps_deg"]),
            _list(row["tilt_sigmas_deg"]),
            f"{196 * row['height_scale_relative_sigma']:.0f} %",
            row["anisotropy_sigma_learnt"],
            row["overdispersion"],
            _list(row["steps_sd_over_bootstraps_deg"]),
            "; ".join(f"without {view}: {_list(steps)}" for view, steps in row["steps_without_one_view_deg"].items()),
        ]
        for case, row in rows.items()
    ]
    return (
        "## Measured series, from their images alone\n\nRepeatability: standard deviation of the steps over tracks "
        "drawn anew (which shows the keypoints' noise alone), and the steps of the views left when one is left out "
        "(four views and more).\n\n"
        + _table(
            [
                "series",
                "tracks",
                "tilt steps (deg)",
                "sigmas of the tilts (deg)",
                "height scale (95 %)",
                "anisotropy learnt",
                "overdispersion",
                "sd over bootstraps (deg)",
                "steps without a view (deg)",
            ],
            body,
        )
    )


def _list(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    cells = (["–" if cell is None else str(cell) for cell in line] for line in lines)
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


if __name__ == "__main__":
    joined: dict[str, Any] = {}
    for name in sys.argv[1:]:
        joined |= json.loads(Path(name).read_text(encoding="utf-8"))
    print(page(joined), end="")
