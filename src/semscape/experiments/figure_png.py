"""One way to draw the experiments' figures, on white, for pages and for print."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 130


def figure_png(size_in: tuple[float, float], draw: Callable[[Figure], None]) -> bytes:
    """Return a figure as PNG bytes; `draw` fills it. matplotlib, slow to load, is imported here."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(
            {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
        )
        figure = Figure(figsize=size_in, layout="constrained")
        draw(figure)
        png = io.BytesIO()
        FigureCanvasAgg(figure)
        figure.savefig(png, format="png", dpi=_DPI)
    return png.getvalue()
