"""Write a whole run folder: the products, then the reports about them."""

from __future__ import annotations

from pathlib import Path

from semscape.io.run_folder import encode_run, json_text, prepare_run_folder, put_files
from semscape.report.html import render_html
from semscape.report.json import report_to_dict
from semscape.types import Result


def write_run(result: Result, folder: Path | str) -> Path:
    """Write every file of the run folder's contract and return the folder.

    Files of an earlier run are replaced one by one, each whole; report.json comes last, so that a folder
    with a new report.json is a complete run.

    Raises
    ------
    BadInputError
        If the folder cannot be written or holds something else than a run.
    """
    path = prepare_run_folder(folder)
    files = encode_run(result)
    files["report.html"] = render_html(result).encode()
    files["report.json"] = json_text(report_to_dict(result)).encode()
    put_files(files, path)
    return path
