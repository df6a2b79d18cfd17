"""The experiments as one page: HTML, Markdown for the docs, JSON, a CSV per table and a PNG per figure.

OUT/experiments.html          one self-contained page
OUT/experiments.md            the same for the docs; its figures are the files below
OUT/experiments.json          every number, unrounded
OUT/experiments/NAME_*.csv    tables
OUT/experiments/NAME_*.png    figures
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from semscape import __version__
from semscape.experiments.study import Experiment, Setting, Table
from semscape.io.run_folder import json_text, put_files
from semscape.report.markup import figure, page, plus_minus, table
from semscape.report.wording import number

FILES = "experiments"
NOT_PUBLISHED = "not published here"
# Nobody reads more rows on a page: they are folded away, or left to the CSV.
_LONGEST_TABLE = 30


def write_experiments(experiments: Sequence[Experiment], setting: Setting, folder: Path | str) -> Path:
    """Write the page of experiments in its forms and return the path of the HTML one.

    Files of other names in the folder are left as they are.

    Raises
    ------
    BadInputError
        If the folder cannot be written.
    """
    path = Path(folder)
    parts: dict[str, bytes] = {}
    for item in experiments:
        parts |= {_file(item, one.name, "csv"): _csv(one) for one in item.tables}
        parts |= {_file(item, one.name, "png"): one.png for one in item.figures}
    put_files(parts, path / FILES)
    pages = {
        "experiments.md": render_markdown(experiments, setting),
        "experiments.json": json_text(experiments_to_dict(experiments, setting)),
        "experiments.html": render_page(experiments, setting),
    }
    put_files({name: text.encode() for name, text in pages.items()}, path)
    return path / "experiments.html"


def experiments_to_dict(experiments: Sequence[Experiment], setting: Setting) -> dict[str, Any]:
    """Return what experiments.json holds: the setting and, per experiment, its texts, tables and figures' files."""
    return {
        "semscape": __version__,
        "seed": setting.seed,
        "quick": setting.quick,
        "experiments": [
            {
                "name": item.name,
                "title": item.title,
                "question": item.question,
                "thesis": item.thesis or NOT_PUBLISHED,
                "tables": [
                    {"name": one.name, "title": one.title, "columns": one.columns, "rows": one.rows, "note": one.note}
                    for one in item.tables
                ],
                "figures": [
                    {"title": one.title, "alt": one.alt, "file": f"{FILES}/{_file(item, one.name, 'png')}"}
                    for one in item.figures
                ],
                "notes": item.notes,
            }
            for item in experiments
        ],
    }


def render_markdown(experiments: Sequence[Experiment], setting: Setting) -> str:
    """Return the page as Markdown; its figures are embedded by their path relative to it."""
    blocks = ["# Experiments", f"<!-- Written by `{_command(experiments)}`; every number comes from there. -->"]
    blocks += _introduction(experiments, setting, quote="`")
    if len(experiments) > 1:
        blocks.append(_markdown_table(("experiment", "in the thesis"), _overview(experiments)))
    for item in experiments:
        blocks += [f"## {item.title}", item.question, f"**In the thesis:** {item.thesis or NOT_PUBLISHED}"]
        for one in item.tables:
            cells = [[_cell(value) for value in row] for row in one.rows]
            long = f"[{len(cells)} rows as CSV]({FILES}/{_file(item, one.name, 'csv')})"
            shown = long if len(cells) > _LONGEST_TABLE else _markdown_table(one.columns, cells)
            blocks += [f"**{one.title}**", shown, one.note]
        for drawn in item.figures:
            path = f"{FILES}/{_file(item, drawn.name, 'png')}"
            blocks += [f"![{drawn.alt}]({path})", f"*{drawn.title}.* {drawn.alt}"]
        blocks.append("\n".join(f"- {note}" for note in item.notes))
    return "\n\n".join(block for block in blocks if block) + "\n"


def render_page(experiments: Sequence[Experiment], setting: Setting) -> str:
    """Return the page as self-contained HTML."""
    introduction = "".join(f'<p class="quiet">{escape(text)}</p>' for text in _introduction(experiments, setting))
    sections = [
        '<header>\n<p class="brand">semscape <span>experiments</span></p>\n<h1>Experiments</h1>\n'
        f"{introduction}\n</header>"
    ]
    if len(experiments) > 1:
        sections.append(f"<section>{table(('Experiment', 'In the thesis'), _overview(experiments))}</section>")
    for item in experiments:
        parts = [
            f"<h2>{escape(item.title)}</h2>",
            f'<p class="basis">{escape(plus_minus(item.question))}</p>',
            f'<p class="basis"><b>In the thesis:</b> {escape(item.thesis or NOT_PUBLISHED)}</p>',
        ]
        for one in item.tables:
            rows = [[_cell(value) for value in row] for row in one.rows]
            cells = table(one.columns, rows)
            if len(rows) > _LONGEST_TABLE:
                cells = f"<details><summary>{len(rows)} rows</summary>{cells}</details>"
            parts += [f"<h3>{escape(one.title)}</h3>", cells]
            parts += [f'<p class="quiet">{escape(plus_minus(one.note))}</p>'] if one.note else []
        parts += [f'<div class="wide">{figure(shown.png, shown.title, shown.alt)}</div>' for shown in item.figures]
        if item.notes:
            parts.append("<ul>" + "".join(f"<li>{escape(plus_minus(note))}</li>" for note in item.notes) + "</ul>")
        sections.append(f'<section id="{escape(item.name)}">{"".join(parts)}</section>')
    return page("Experiments · semscape", sections)


def _introduction(experiments: Sequence[Experiment], setting: Setting, quote: str = "") -> list[str]:
    told = (
        f"Written by {quote}{_command(experiments)}{quote} of semscape {__version__}, seed {setting.seed}; the same "
        "command gives the same numbers, but for times. "
        + ("With measured sets." if setting.data is not None else "Without measured sets.")
    )
    hasty = "A quick run, to see that it works: small images and few cases. Its figures are not those of the method."
    return [told, hasty] if setting.quick else [told]


def _command(experiments: Sequence[Experiment]) -> str:
    return f"semscape experiments {experiments[0].name if len(experiments) == 1 else 'all'}"


def _overview(experiments: Sequence[Experiment]) -> list[list[str]]:
    return [[item.title, item.thesis or NOT_PUBLISHED] for item in experiments]


def _cell(value: Any) -> str:
    """Return a cell for people; `number` knows what is unknown, and how many digits tell something."""
    return value if isinstance(value, str) else number(value)


def _markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [columns, ["---"] + ["---:"] * (len(columns) - 1), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _csv(one: Table) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(one.columns)
    writer.writerows([["" if value is None or value != value else value for value in row] for row in one.rows])
    return text.getvalue().encode()


def _file(item: Experiment, name: str, suffix: str) -> str:
    return f"{item.name}_{name}.{suffix}"
