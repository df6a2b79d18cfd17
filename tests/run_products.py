"""Options for quick runs, and the files of a run whose bytes repeat."""

from __future__ import annotations

from pathlib import Path

from semscape.io.run_folder import RUN_FILES
from semscape.options import Options

QUICK = Options().with_settings(["sfm.de_generations=10", "dense.max_pairs=1", "dense.mesh_max_vertices=2000"])
PRODUCTS = [name for name in RUN_FILES if not name.startswith("report.")]  # reports hold times


def products(run: Path) -> dict[str, bytes]:
    return {name: (run / name).read_bytes() for name in PRODUCTS}
