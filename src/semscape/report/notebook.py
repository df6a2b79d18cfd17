"""A result in a notebook: the viewer in a frame of its own, or a picture where no script runs."""

from __future__ import annotations

from html import escape

from semscape.report.figures import height_picture
from semscape.report.markup import content_policy, picture_data
from semscape.report.viewer_page import viewer_parts, viewer_script
from semscape.types import Result

_MOST_HEIGHTS = 400_000
_HEIGHT_PX = 780


def notebook_html(result: Result) -> str:
    """Return the viewer as a frame; without scripts it holds the picture of the heights.

    At most 400,000 heights are shown, every n-th row and column: a notebook keeps what it has shown.
    """
    picture = picture_data(height_picture(result.height_map))
    still = f'<img src="{picture}" alt="Height map" style="max-width: 100%">'
    script = viewer_script()
    if script is None:
        return still
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Surface</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{content_policy(script)}">'
        "<style>body { margin: 0 }</style></head><body>"
        f"<noscript>{still}</noscript>{viewer_parts(result, _MOST_HEIGHTS)}<script>{script}</script></body></html>"
    )
    # The frame is a page of its own, which can reach neither the notebook nor the network.
    return (
        f'<iframe srcdoc="{escape(page)}" sandbox="allow-scripts allow-downloads" title="Surface" '
        f'style="width: 100%; height: {_HEIGHT_PX}px; border: 1px solid #8884; border-radius: 8px"></iframe>'
    )
