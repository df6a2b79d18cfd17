"""semscape: metric 3D surfaces with a stated uncertainty from tilted SEM images.

    series = semscape.load_series("pollen/")
    result = semscape.reconstruct(series, semscape.Options(), rng=0)

The functions load what they need when they are first asked for, so that importing semscape stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from semscape.errors import BadInputError, DegenerateGeometryError, NoAnswerError, SemscapeError, TooFewMatchesError
from semscape.options import Options

if TYPE_CHECKING:
    from semscape.io.series import load_series
    from semscape.pipeline import reconstruct
    from semscape.report.conversion import convert

__version__ = "0.1.0"

_MODULE_OF = {
    "convert": "semscape.report.conversion",
    "load_series": "semscape.io.series",
    "reconstruct": "semscape.pipeline",
}

__all__ = [
    "BadInputError",
    "DegenerateGeometryError",
    "NoAnswerError",
    "Options",
    "SemscapeError",
    "TooFewMatchesError",
    "convert",
    "load_series",
    "reconstruct",
]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        return getattr(import_module(_MODULE_OF[name]), name)
    raise AttributeError(f"module 'semscape' has no attribute {name!r}")
