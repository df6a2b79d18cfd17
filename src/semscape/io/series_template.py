"""Write a `series.toml` that says what was understood of a folder, for its user to edit."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from semscape.errors import BadInputError
from semscape.io.series import natural_key
from semscape.io.series_toml import OVERRIDES, SIDECAR_NAME


def write_series_toml(folder: Path, views: Sequence[Mapping[str, Any]], warnings: Sequence[str]) -> Path:
    """Write the `series.toml` of a folder that has none, and return its path.

    Raises
    ------
    BadInputError
        Where there is one already, or the folder cannot be written.
    """
    path = folder / SIDECAR_NAME
    text = series_toml_text(views, warnings)
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        name = text[error.start : error.end].encode(errors="backslashreplace").decode()
        raise BadInputError(
            f"{path}: cannot be written, for the name of an image holds what is no text ({name}); rename the image"
        ) from error
    try:
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError as error:
        raise BadInputError(f"{path}: exists and is not overwritten; edit it, or move it away first") from error
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def series_toml_text(views: Sequence[Mapping[str, Any]], warnings: Sequence[str]) -> str:
    """Return a `series.toml` that says what was understood, every line a comment for the user to take up and edit.

    Parameters
    ----------
    views : sequence of dict
        As `semscape.io.inspect.describe_series` returns them.
    warnings : sequence of str
        Those of the series; they head the file.
    """
    ordered = sorted(views, key=lambda view: natural_key(view["name"]))
    lines = [
        "# What semscape understood of this folder. Lines that begin with # change nothing: take the # away and edit",
        "# the value to override it. What you give on the command line goes before this file.",
        *(f"# warning: {' '.join(warning.split())}" for warning in warnings),
        "",
        "# one tilt for each image, in deg and in the sign of docs/acquire.md, in this order:",
        *(f"#   {' '.join(view['name'].split())}" for view in ordered),
        _line("tilts_deg", [_rounded(view["tilt_deg"]) for view in ordered], ordered),
        "# direction of the tilt axis in the image: 0 horizontal, 90 vertical, counter-clockwise",
        _line("axis_deg", ordered[0].get("axis_deg"), ordered),
        "",
        "# for all images:",
    ]
    shared: list[str] = []
    different: list[str] = []
    for key in OVERRIDES:
        values = [view.get(key) for view in ordered]
        (shared if all(value == values[0] for value in values) else different).append(key)
    lines += [_line(key, ordered[0].get(key), ordered) for key in shared]
    lines += ["# length that the scale bar in the images stands for; it gives the pixel size", "# scale_bar_um = 10.0"]
    for view in ordered if different else []:
        lines += ["", f"# [images.{json.dumps(view['name'], ensure_ascii=False)}]"]
        lines += [_line(key, view.get(key), [view]) for key in different]
    return "\n".join(lines) + "\n"


def _line(key: str, value: Any, views: Sequence[Mapping[str, Any]]) -> str:
    source = views[0].get("origins", {}).get(key) or views[0].get("sources", {}).get(key, "")
    note = f"  # from {source}" if source else ""
    if value is None or (isinstance(value, list) and None in value):
        return f"# {key} = ...  # unknown"
    return f"# {key} = {json.dumps(value)}{note}"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6) + 0.0
