"""Options for quick runs, reports without their drawings, and the files of a run whose bytes repeat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from semscape.io.png import encode_png
from semscape.io.run_folder import RUN_FILES
from semscape.options import Options

QUICK = Options().with_settings(["sfm.de_generations=10", "dense.max_pairs=1", "dense.mesh_max_vertices=2000"])
PRODUCTS = [name for name in RUN_FILES if not name.startswith("report.")]  # reports hold times

_UNDRAWN = encode_png(np.random.default_rng(0).integers(0, 256, (220, 220), dtype=np.uint8), "not drawn")


def undrawn(*_: Any, **__: Any) -> bytes:
    """Stand in for `figures.drawn_png` where faults are tested: drawing is most of a small run's time."""
    return _UNDRAWN


def products(run: Path) -> dict[str, bytes]:
    return {name: (run / name).read_bytes() for name in PRODUCTS}
