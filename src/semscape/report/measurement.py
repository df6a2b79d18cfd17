"""A measurement as JSON, CSV and a table: every value with its unit, its sigma where there is one, and the warnings."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from semscape.errors import BadInputError
from semscape.io.finished_run import FinishedRun
from semscape.io.run_folder import json_text, put_files
from semscape.metrology.findings import Figure
from semscape.metrology.measure import Measurement, measure, measure_change
from semscape.metrology.request import MeasureRequest
from semscape.report.console import print_line

_DIGITS = 4


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """A run, what was asked of it and what was measured; `figures` and `warnings` hold those of a comparison, too."""

    run: FinishedRun
    request: MeasureRequest
    measurement: Measurement
    figures: tuple[Figure, ...]
    warnings: tuple[str, ...]
    since: str = ""

    def json(self) -> str:
        """Return the measurement as JSON text."""
        return json_text(measured_to_dict(self))


def measure_run(run: FinishedRun, request: MeasureRequest, since: FinishedRun | None = None) -> MeasuredRun:
    """Measure a run, and what has changed since an earlier one; warnings of the run come first.

    Raises
    ------
    NoAnswerError
        If too few heights are known where something is to be measured.
    BadInputError
        If the earlier run has another pixel size.
    """
    measurement = measure(
        run.height_map,
        request,
        height_scale_relative_sigma=run.height_scale_relative_sigma,
        rng=np.random.default_rng(request.options.seed),
    )
    figures, warnings = measurement.figures, measurement.warnings
    if run.ambiguity not in ("", "none"):
        warnings = (
            "the sign of the relief is assumed from its shading: if it is wrong, peaks are pits (Sp and Sv, Spk and "
            "Svk, the signs of Ssk and of steps, the volumes)",
            *warnings,
        )
    if run.verdict.startswith("do not measure"):
        warnings = (run.verdict, *warnings)
    if since is not None:
        changed, comparison = measure_change(run.height_map, since.height_map, request.region)
        figures += changed
        if comparison.overlap < 0.5:
            warnings += (f"the two maps share {comparison.overlap:.0%} of the field only",)
    return MeasuredRun(run, request, measurement, figures, warnings, "" if since is None else since.name)


def measured_to_dict(measured: MeasuredRun) -> dict[str, Any]:
    """Return a measurement as plain values: what it is of, how it was made, figures with units, warnings."""
    run, resolution = measured.run, measured.measurement.resolution
    unit, pixel_size = run.height_map.length_unit, run.height_map.pixel_size_um
    places = {name: place for name, place in asdict(measured.request).items() if name != "options" and place}
    if measured.request.edges:
        places["edges"] = [edge / pixel_size for edge in measured.request.edges]
    return {
        "run": run.name,
        "since": measured.since or None,
        "length_unit": unit,
        f"pixel_size_{unit}": pixel_size,
        "height_scale_relative_sigma": run.height_scale_relative_sigma,
        f"lateral_period_limit_{unit}": resolution.period,
        f"lateral_period_limit_10_and_90_percent_{unit}": [pixel_size * px for px in resolution.range_px],
        "lateral_period_limit_from": resolution.source,
        "noise_correlation_sigma_px": resolution.sigma_px,
        "options": asdict(measured.request.options),
        "places_px": places,
        "figures": [asdict(figure) for figure in measured.figures],
        "warnings": list(measured.warnings),
    }


def write_measurement(measured: MeasuredRun, folder: Path) -> None:
    """Write measurement.json, measurement.csv and, of a profile, profile.csv into a folder.

    Raises
    ------
    BadInputError
        If the folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"the output folder {folder} cannot be made: {error.strerror or error}") from error
    names = ["group", "name", "value", "sigma", "unit", "noise_bias", "meaning"]
    rows = [[getattr(figure, name) for name in names] for figure in measured.figures]
    files = {"measurement.json": measured.json().encode(), "measurement.csv": _csv(names, rows)}
    profile, unit = measured.measurement.profile, measured.run.height_map.length_unit
    if profile is not None:
        points = np.column_stack([profile.distance, profile.height]).tolist()
        files["profile.csv"] = _csv([f"distance_{unit}", f"height_{unit}"], points)
    put_files(files, folder)


def print_measurement(measured: MeasuredRun, console: Console) -> None:
    """Print a table of all figures, a block per group, how they were made, and the warnings."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    run, options, resolution = measured.run, measured.request.options, measured.measurement.resolution
    unit = run.height_map.length_unit
    rows, cols = measured.measurement.surface.shape
    print_line(f"{run.name}: {cols} x {rows} px of {run.height_map.pixel_size_um:.6g} {unit}", console, "bold")
    filters = [
        f"{name}-filter " + ("none" if math.isnan(index) else f"{index:g} {unit} (Gaussian)")
        for name, index in (("S", options.s_filter_um), ("L", options.l_filter_um))
    ]
    form = "no levelling" if options.level == "none" else f"{options.level} removed"
    print_line(", ".join([form + (" (robust)" if options.robust else ""), *filters]), console)
    low, high = (run.height_map.pixel_size_um * px for px in resolution.range_px)
    seen = {"spectrum": "from the map's spectrum", "pixel": "two pixels"}
    seen["matching"] = f"of the matching; {low:.4g} to {high:.4g} {unit} from place to place"
    print_line(f"lateral resolution (half height): {resolution.period:.4g} {unit}, {seen[resolution.source]}", console)
    table = Table(box=box.SIMPLE_HEAD if console.is_terminal else box.ASCII2, pad_edge=False)
    for title, justify in (
        ("", "left"),
        ("value", "right"),
        ("± sigma", "right"),
        ("unit", "left"),
        ("meaning", "left"),
    ):
        table.add_column(title, justify=justify)  # type: ignore[arg-type]
    for _, group in groupby(measured.figures, key=lambda figure: figure.group):
        for figure in (block := list(group)):
            name = figure.name if not figure.group.startswith("step") else f"{figure.group}: {figure.name}"
            value, sigma = _rounded(figure)
            cells = [name, value, sigma, figure.unit or "1", figure.meaning]
            encoding = console.encoding or "utf-8"
            plain = (cell.encode(encoding, "replace").decode(encoding) for cell in cells)
            table.add_row(*(Text(cell) for cell in plain), end_section=figure is block[-1])
    console.print(table)
    if math.isfinite(run.height_scale_relative_sigma):
        share = run.height_scale_relative_sigma
        print_line(f"all heights share a relative sigma of {share:.2%} (height scale); it is in the sigmas", console)
    for warning in measured.warnings:
        print_line(f"warning: {warning}", console, "yellow")


def _rounded(figure: Figure) -> tuple[str, str]:
    """Return value and sigma as text, the value to the place of the sigma's second digit; else to four digits."""
    if not math.isfinite(figure.value):
        return "unknown", ""
    if not (math.isfinite(figure.sigma) and figure.sigma > 0):
        return f"{figure.value:.{_DIGITS}g}", ""
    places = 1 - math.floor(math.log10(figure.sigma))
    if not 0 <= places <= 9:
        return f"{figure.value:.6g}", f"{figure.sigma:.2g}"
    return f"{figure.value:.{places}f}", f"{figure.sigma:.{places}f}"


def _csv(names: list[str], rows: list[list[Any]]) -> bytes:
    """Return a table as CSV in UTF-8, unknown numbers as empty fields."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(["" if isinstance(v, float) and math.isnan(v) else v for v in row] for row in rows)
    return text.getvalue().encode()
