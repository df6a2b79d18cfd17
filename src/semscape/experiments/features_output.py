"""The table of detectors in its forms: a table of an experiment, text for the console, CSV and JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from semscape.errors import BadInputError
from semscape.experiments.features_table import TOLERANCE_PX, DetectorFigures
from semscape.experiments.study import Table
from semscape.io.run_folder import json_text, put_files
from semscape.options import Options

# Title and format of each field of DetectorFigures.
_COLUMNS = {
    "detector": ("detector", "s"),
    "keypoints": ("keypoints", ".0f"),
    "putative": ("putative", ".0f"),
    "putative_precision": ("right (%)", ".1%"),
    "inliers": ("inliers", ".0f"),
    "precision": ("right inliers (%)", ".1%"),
    "residual_px": ("residual (px)", ".3f"),
    "error_px": ("error (px)", ".3f"),
    "detect_s": ("detect (s)", ".2f"),
    "match_s": ("match (s)", ".2f"),
    "failed": ("failed pairs", "d"),
}
_WRITERS = (".csv", ".json")


def features_note(rows: Sequence[DetectorFigures]) -> str:
    """Return what the columns mean, in two sentences."""
    has_truth = any(row.putative_precision is not None for row in rows)
    right = f"Right is within {TOLERANCE_PX:g} px of the true place." if has_truth else "No truth is known here."
    return (
        "Keypoints and detect: mean per view; putative matches, inliers and match: mean per consecutive pair; residual "
        f"(to the epipolar line) and error (to the true place): median over the inliers of all pairs. {right}"
    )


def features_table(rows: Sequence[DetectorFigures], name: str, title: str) -> Table:
    """Return the rows as a table of an experiment, shares in percent."""
    cells = [[_in_percent(spec, value) for spec, value in asdict(row).items()] for row in rows]
    return Table(
        name, title, tuple(title for title, _ in _COLUMNS.values()), tuple(map(tuple, cells)), features_note(rows)
    )


def features_text(rows: Sequence[DetectorFigures]) -> str:
    """Return the rows as lines of a fixed width, a dash where there is no value, and the note."""
    table = [[title for title, _ in _COLUMNS.values()]]
    for row in rows:
        values = asdict(row).items()
        table.append(["-" if value is None else format(value, _COLUMNS[key][1]).rstrip("%") for key, value in values])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) if index == 0 else cell.rjust(width) for index, (cell, width) in enumerate(sized))
        for sized in (zip(line, widths, strict=True) for line in table)
    ]
    return "\n".join([*lines, "", features_note(rows)])


def features_json(rows: Sequence[DetectorFigures], options: Options) -> str:
    """Return the rows, the tolerance and the options in force as JSON, null where there is no value."""
    told = options.to_dict()
    return json_text(
        {
            "tolerance_px": TOLERANCE_PX,
            "detectors": [asdict(row) for row in rows],
            "options": {stage: told[stage] for stage in ("features", "robust", "run")},
        }
    )


def features_csv(rows: Sequence[DetectorFigures]) -> str:
    """Return the rows as CSV, one column per field of `DetectorFigures`, empty where there is no value."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, [spec.name for spec in fields(DetectorFigures)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return buffer.getvalue()


def require_known_suffix(path: Path) -> None:
    """Refuse a file that is neither CSV nor JSON, before any work is done for it.

    Raises
    ------
    BadInputError
        With the suffixes that there are.
    """
    if path.suffix.lower() not in _WRITERS:
        raise BadInputError(f"{path}: the table is written as {' or '.join(_WRITERS)}, give a name that ends so")


def write_features(rows: Sequence[DetectorFigures], options: Options, path: Path) -> None:
    """Write the rows as CSV or JSON, as the file's name ends.

    Raises
    ------
    BadInputError
        For another ending, or a place that cannot be written.
    """
    require_known_suffix(path)
    text = features_csv(rows) if path.suffix.lower() == ".csv" else features_json(rows, options)
    put_files({path.name: text.encode()}, path.parent)


def _in_percent(key: str, value: Any) -> Any:
    return 100 * value if value is not None and _COLUMNS[key][1].endswith("%") else value
