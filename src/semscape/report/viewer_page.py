"""The viewer inside a page: its script, its surface, and what the browser may run. Nothing is fetched."""

from __future__ import annotations

import base64
from functools import cache
from importlib.resources import files

import semscape
from semscape.report.surface_file import surface_of_result
from semscape.types import Result

_REPORT_HEIGHTS = 1_600_000


@cache
def viewer_script() -> str | None:
    """Return the viewer's bundle, or None in a source tree where it was not built (`make web` does)."""
    bundle = files(semscape) / "web" / "report.js"
    return bundle.read_text(encoding="utf-8") if bundle.is_file() else None


def viewer_parts(result: Result, most_heights: int = _REPORT_HEIGHTS) -> str:
    """Return the viewer's place in a page with the surface it shows; `viewer_script` must follow."""
    surface = base64.b64encode(surface_of_result(result, most_heights)).decode("ascii")
    return (
        '<div id="semscape-viewer"></div>\n'
        f'<script type="application/octet-stream" id="semscape-surface">{surface}</script>'
    )
