"""Reconstruct a folder of tilted images and write a run folder.

    python examples/reconstruct_folder.py FOLDER RUN

Without arguments a small tilt series is simulated and reconstructed in a temporary folder.
"""

import sys
import tempfile
from pathlib import Path

import semscape
from semscape.io.simulated import write_simulated_series
from semscape.report.run import write_run
from semscape.simulate import SimulationOptions, simulate


def main(folder: Path, run: Path) -> None:
    """Reconstruct `folder` into `run` and print what matters."""
    series = semscape.load_series(folder)
    result = semscape.reconstruct(series, rng=0)
    write_run(result, run)
    low, high = result.report.metrics["height_min"], result.report.metrics["height_max"]
    print(f"{series.n_views} views, heights from {low:.2f} to {high:.2f} {result.height_map.length_unit}")
    print(result.report.verdict)
    print(f"report: {run / 'report.html'}")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        main(Path(sys.argv[1]), Path(sys.argv[2]))
    else:
        scratch = Path(tempfile.mkdtemp(prefix="semscape-"))
        small = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=320, height_px=320)
        images = write_simulated_series(scratch / "images", *simulate("fracture", small, rng=1))
        main(images, scratch / "run")
