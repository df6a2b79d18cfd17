"""The summary of a batch: summary.csv for programs, summary.html for people."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from semscape.batch.manifest import Specimen
from semscape.batch.record import RECORDS_NAME, Ending, Record
from semscape.io.run_folder import put_files
from semscape.report.markup import page, picture_data, plus_minus
from semscape.report.wording import UNIT_SIGNS, number

_FIGURES = (
    "n_views",
    "n_points",
    "rms_px",
    "height_range",
    "median_uncertainty",
    "pixel_size",
    "completeness",
    "height_scale_relative_sigma_95",
)
COLUMNS = (
    *("name", "state", "kept", "verdict", "reason", "exit_code", "length_unit", *_FIGURES, "tilt_source"),
    *("warnings", "seconds", "peak_memory_mb", "bytes_sent", "folder", "run"),
)
_PER_PAGE = 200
_VERDICT_STYLES = (("good", "good"), ("usable", "warn"), ("do not measure", "bad"))
Row = tuple[Specimen, Ending | None]


def write_summary(output: Path, rows: Sequence[Row]) -> None:
    """Write summary.csv and summary.html of all specimens, those that have not ended as "waiting".

    A page holds 200 specimens; summary-2.html and so on hold what is beyond.

    Raises
    ------
    BadInputError
        If the folder cannot be written.
    """
    put_files({"summary.csv": _csv(rows).encode()}, output)
    pages = max(1, math.ceil(len(rows) / _PER_PAGE))
    for index in range(pages):
        part = rows[index * _PER_PAGE : (index + 1) * _PER_PAGE]
        put_files({_page_name(index): _html(output, rows, part, index, pages).encode()}, output)


def _csv(rows: Sequence[Row]) -> str:
    stream = io.StringIO()
    writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for specimen, ending in rows:
        writer.writerow({key: _cell(value) for key, value in _values(specimen, ending).items()})
    return stream.getvalue()


def _values(specimen: Specimen, ending: Ending | None) -> dict[str, Any]:
    start = {"name": specimen.name, "state": "waiting", "folder": str(specimen.folder)}
    if ending is None:
        return start
    record, report = ending.record, ending.record.report
    metrics = report.get("metrics", {})
    return start | {
        "state": record.state,
        "kept": "yes" if ending.kept else "no",
        "verdict": report.get("verdict", ""),
        "reason": record.reason,
        "exit_code": record.exit_code,
        "length_unit": report.get("length_unit", ""),
        **{key: metrics.get(key) for key in _FIGURES},
        "tilt_source": report.get("tilt_source", ""),
        "warnings": len(report.get("warnings", ())),
        "seconds": round(record.seconds, 3),
        "peak_memory_mb": record.peak_memory_mb,
        "bytes_sent": ending.n_bytes,
        "run": specimen.name if record.state == "done" else "",
    }


def _cell(value: Any) -> Any:
    """Return a cell that no spreadsheet takes for a formula; unknown is empty."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value


def _html(output: Path, rows: Sequence[Row], part: Sequence[Row], index: int, pages: int) -> str:
    states = [ending.record.state if ending else "waiting" for _, ending in rows]
    counts = ", ".join(f"{states.count(state)} {state}" for state in ("done", "failed", "waiting") if state in states)
    links = " ".join(
        f"<b>{other + 1}</b>" if other == index else f'<a href="{_page_name(other)}">{other + 1}</a>'
        for other in range(pages)
    )
    header = (
        f'<header><p class="brand">semscape <span>batch</span></p><h1>{len(rows)} specimens</h1>'
        f'<p class="quiet">{counts}{f" · page {links}" if pages > 1 else ""}</p></header>'
    )
    failed = [(s, e.record) for s, e in rows if e and e.record.state == "failed"] if index == 0 else []
    notice = ""
    if failed:
        items = "".join(
            f"<li><b>{escape(s.name)}</b>: {escape(record.reason)}</li>" for s, record in failed[:_PER_PAGE]
        )
        more = f"<li>and {len(failed) - _PER_PAGE} more, in summary.csv</li>" if len(failed) > _PER_PAGE else ""
        notice = f'<section class="notice bad"><h2>Failed: {len(failed)}</h2><ul>{items}{more}</ul></section>'
    head = ("", "Specimen", "Verdict", "Views", "Height range", "Completeness", "Residual (px)", "Seconds")
    titles = "".join(f"<th{' class=num' if place > 2 else ''}>{title}</th>" for place, title in enumerate(head))
    body = "".join(_html_row(output, specimen, ending) for specimen, ending in part)
    table = f'<div class="scroll"><table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></div>'
    return page("semscape batch", (header, notice, f"<section>{table}</section>"))


def _html_row(output: Path, specimen: Specimen, ending: Ending | None) -> str:
    if ending is None:
        return f'<tr><td></td><td>{escape(specimen.name)}</td><td class="quiet">waiting</td>{"<td></td>" * 5}</tr>'
    record = ending.record
    if record.state == "failed":
        reason = f'<p class="verdict bad">failed</p><p class="quiet">{escape(record.reason)}</p>'
        return (
            f"<tr><td></td><td>{escape(specimen.name)}</td><td>{reason}</td>{'<td></td>' * 4}"
            f'<td class="num">{number(record.seconds, 3)}</td></tr>'
        )
    metrics: Mapping[str, Any] = record.report.get("metrics", {})
    verdict = str(record.report.get("verdict", ""))
    style = next((style for start, style in _VERDICT_STYLES if verdict.startswith(start)), "plain")
    unit = UNIT_SIGNS["px" if record.report.get("length_unit") == "px" else "um"]
    completeness = metrics.get("completeness")
    figures = (
        number(metrics.get("n_views")),
        f"{number(metrics.get('height_range'), 3)} {unit}",
        "–" if completeness is None else f"{100 * completeness:.0f} %",
        number(metrics.get("rms_px"), 2),
        number(record.seconds, 3),
    )
    cells = "".join(f'<td class="num">{text}</td>' for text in figures)
    link = f'<a href="{quote(specimen.name)}/report.html">{escape(specimen.name)}</a>'
    return (
        f"<tr><td>{_thumbnail(output, record)}</td><td>{link}</td>"
        f'<td><p class="verdict {style}">{escape(plus_minus(verdict))}</p></td>{cells}</tr>'
    )


def _thumbnail(output: Path, record: Record) -> str:
    try:
        png = (output / RECORDS_NAME / f"{record.name}.png").read_bytes()
    except OSError:
        return ""
    return f'<img src="{picture_data(png)}" alt="shaded relief of {escape(record.name)}" width="96">'


def _page_name(index: int) -> str:
    return "summary.html" if index == 0 else f"summary-{index + 1}.html"
