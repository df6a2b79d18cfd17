"""Write the tables of the surface's accuracy into docs/surface.md and docs/method.md, from JSON.

`python benchmarks/surface_tables.py FILE ...`: FILE holds what `benchmarks/accuracy.py` or `benchmarks/height_bound.py`
prints; several are joined, so that cases may be run apart. A table is written where all its rows are there, between
its two marks in the page.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from isolated import REPOSITORY

_METHODS = {"semscape": "semscape", "opencv_sgbm": "StereoSGBM", "opencv_dis": "DIS flow"}
_CAMERAS = {"true_cameras": "true", "estimated_cameras": "estimated"}
_SPECIMENS = ("fracture", "spheres", "vickers", "grating", "pollen")
_REAL = ("potamogeton1", "quartz", "dsa")
_SHAPES = ("step", "vickers", "grating")


def heights(rows: dict[str, Any]) -> str:
    """Return the table of errors of heights and normals, and of completeness."""
    head = ["", "cameras"]
    head += [f"{name}: median, rmse (px)" for name in _METHODS.values()]
    head += ["normals (deg)", "completeness (%)"]
    body = []
    for specimen, cameras, row in _surfaces(rows, _SPECIMENS):
        found = [row[method] for method in _METHODS]
        body.append(
            [
                specimen,
                cameras,
                *(f"{each['median_px']:.2f}, {each['trimmed_rmse_px']:.2f}" for each in found),
                " / ".join(f"{each['normal_median_deg']:.0f}" for each in found),
                " / ".join(f"{100 * each['completeness']:.0f}" for each in found),
            ]
        )
    return _table(head, body)


def sigmas(rows: dict[str, Any]) -> str:
    """Return the table of the shares of errors within 1 sigma."""
    body = []
    for specimen, cameras, row in _surfaces(rows, _SPECIMENS):
        ours = row["semscape"]
        bins = ", ".join(f"{100 * share:.0f}" for share in ours["within_1_sigma_by_bin"])
        body.append([specimen, cameras, f"{100 * ours['within_1_sigma']:.0f}", bins])
    return _table(["", "cameras", "within 1 sigma (%)", "in five bins of sigma (%)"], body)


def shapes(rows: dict[str, Any]) -> str:
    """Return the table of the step, the indent and the walls."""
    body = []
    for specimen, cameras, row in _surfaces(rows, _SHAPES):
        what, true = _SHAPE_OF[specimen](row["semscape"])
        found = [_SHAPE_VALUE[specimen](row[method]) for method in _METHODS]
        body.append([what, cameras, true, *found])
    return _table(["", "cameras", "true", *_METHODS.values()], body)


def pairs(rows: dict[str, Any]) -> str:
    """Return the table of the heights from two pairs of views that share none, or one of three views."""
    body = []
    for name in (each for each in _REAL if "disjoint" in rows.get(f"disjoint-{each}", {})):
        for split in rows[f"disjoint-{name}"]["disjoint"]:
            views = " against ".join(f"{first + 1}, {second + 1}" for first, second in split["pairs"])
            found = [
                f"{split[method]['median_px']:.2f}, {split[method]['trimmed_rms_px']:.2f} "
                f"({100 * split[method]['compared']:.0f} %)"
                for method in _METHODS
            ]
            body.append([name, views, *found])
    return _table(["", "views", *_METHODS.values()], body)


def stereo(rows: dict[str, Any]) -> str:
    """Return the table of the matcher on a perspective pair."""
    row = rows["stereo"]
    body = [
        [_METHODS[method], *(f"{100 * row[method][key]:.1f} %" for key in ("known", "wrong_of_known", "right_of_all"))]
        for method in ("semscape", "opencv_sgbm")
    ]
    return _table(["", "known", "off by more than 1 px, of the known", "right within 1 px, of all"], body)


def bound(rows: dict[str, Any]) -> str:
    """Return the table of what the images allow beside what is reached, both with the true cameras."""
    head = [
        "",
        "best window",
        "oracle: noise",
        "and scan",
        "and shading",
        "reached",
        "ratio",
        "normals: oracle",
        "reached",
    ]
    body = []
    for specimen in (each for each in _SPECIMENS if each in rows):
        told = rows[specimen]
        oracle, reached = told["oracle"], rows[f"surface-{specimen}"]["true_cameras"]["semscape"]
        window = min(told["windows"], key=lambda each: each["median_px"])
        body.append(
            [
                specimen,
                f"{window['median_px']:.2f} ({window['side_px']} px)",
                *(_two(oracle[name]) for name in ("noise", "noise_drift_jitter", "all")),
                _two(reached),
                f"{reached['median_px'] / oracle['noise_drift_jitter']['median_px']:.2f}",
                f"{oracle['noise_drift_jitter']['normal_median_deg']:.1f}",
                f"{reached['normal_median_deg']:.1f}",
            ]
        )
    return _table(head, body)


def _two(figures: dict[str, Any]) -> str:
    return f"{figures['median_px']:.2f}, {figures['trimmed_rmse_px']:.2f}"


def _step_height(row: dict[str, Any]) -> tuple[str, str]:
    return "step (px)", f"{row['true_step_px']:.2f} ± {row['allowed_px']:.2f}"


def _face_angles(row: dict[str, Any]) -> tuple[str, str]:
    return "Vickers, opposite faces (deg)", ", ".join(f"{angle:.2f}" for angle in row["true_face_angles_deg"])


def _wall_widths(_: dict[str, Any]) -> tuple[str, str]:
    return "walls, 10 to 90 %: quartiles (px); known (%)", "0"


def _wall_value(row: dict[str, Any]) -> str:
    widths = row.get("wall_px_25_50_75_90_percent")
    known = f"{100 * row['walls_known']:.0f}"
    return f"{', '.join(f'{width:.1f}' for width in widths[:3])}; {known}" if widths else f"-; {known}"


_SHAPE_OF = {"step": _step_height, "vickers": _face_angles, "grating": _wall_widths}
_SHAPE_VALUE = {
    "step": lambda row: f"{row['step_px']:.2f}",
    "vickers": lambda row: ", ".join(f"{angle:.2f}" for angle in row["face_angles_deg"]),
    "grating": _wall_value,
}


def _surfaces(rows: dict[str, Any], specimens: Iterable[str]) -> Iterable[tuple[str, str, dict[str, Any]]]:
    for specimen in specimens:
        for key, cameras in _CAMERAS.items():
            if key in (row := rows[f"surface-{specimen}"]):
                yield specimen, cameras, row[key]


def _table(head: list[str], body: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *body))


_TABLES = {
    "surface.md": {"heights": heights, "sigmas": sigmas, "shapes": shapes, "pairs": pairs, "stereo": stereo},
    "method.md": {"bound": bound},
}


def main(files: list[str]) -> None:
    """Write every table whose rows are in the files into its page."""
    rows: dict[str, Any] = {}
    for file in files:
        rows |= json.loads(Path(file).read_text(encoding="utf-8"))
    for page, tables in _TABLES.items():
        path = REPOSITORY / "docs" / page
        text = path.read_text(encoding="utf-8")
        for name, table in tables.items():
            try:
                new = table(rows)
            except KeyError as missing:
                print(f"{name}: no row {missing}", file=sys.stderr)
                continue
            marked = re.compile(rf"(<!-- table {name} -->\n).*?(<!-- end -->)", re.DOTALL)
            text = marked.sub(lambda found, new=new: f"{found[1]}{new}\n{found[2]}", text)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
