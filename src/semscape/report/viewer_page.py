"""The viewer inside a page: its script, its surface, and what the browser may run. Nothing is fetched."""

from __future__ import annotations

import base64
from functools import cache
from html import escape
from importlib.resources import files

import semscape
from semscape.report.markup import content_policy
from semscape.report.surface_file import surface_of_result
from semscape.types import Result

_REPORT_HEIGHTS = 1_600_000
_NOTEBOOK_HEIGHTS = 400_000


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


def notebook_frame(result: Result, picture: str) -> str:
    """Return the viewer as a frame for a notebook, with `picture` (the address of one) where no script may run."""
    script = viewer_script()
    still = f'<img src="{picture}" alt="Height map" style="max-width: 100%">'
    if script is None:
        return still
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Surface</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{content_policy(script)}">'
        "<style>body { margin: 0 } #semscape-viewer { height: 100vh; display: grid }</style></head><body>"
        f"<noscript>{still}</noscript>{viewer_parts(result, _NOTEBOOK_HEIGHTS)}<script>{script}</script></body></html>"
    )
    return (
        f'<iframe srcdoc="{escape(page)}" sandbox="allow-scripts allow-downloads" title="Surface" '
        'style="width: 100%; height: 760px; border: 1px solid #8884; border-radius: 8px"></iframe>'
    )
