"""A run folder against a truth on disk: what `semscape evaluate` does."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from semscape.errors import BadInputError
from semscape.evaluate.align import ALIGNMENTS
from semscape.evaluate.distances import surface_figures
from semscape.evaluate.run import evaluate
from semscape.evaluate.surface import make_surface
from semscape.evaluate.units import Units
from semscape.io.finished_run import input_digests
from semscape.io.mesh_file import read_mesh
from semscape.io.run_folder import put_files, read_motion
from semscape.io.simulated import truth_of_views
from semscape.io.surfaces import read_height_map
from semscape.report.figures import error_picture
from semscape.types import HeightMap

PICTURE = "height_error.png"


def evaluate_run(run: Path, truth: Path, output: Path) -> tuple[dict[str, Any], Path | None]:
    """Compare a run folder with its truth.

    Parameters
    ----------
    run : Path
        A run folder.
    truth : Path
        The folder of the simulated series that was reconstructed, or the file of a mesh in um.
    output : Path
        Folder in which the picture of the signed height errors is put; it is made where it does not exist.

    Returns
    -------
    figures : dict
        Those of `semscape.evaluate.run.evaluate`; against a mesh, of its surface alone.
    picture : Path or None
        None against a mesh, which has no grid in common with the run.

    Raises
    ------
    BadInputError
        If a file cannot be read, or run and truth do not belong together.
    """
    height_map = read_height_map(run / "height_map.npz")
    where = {"run": str(run), "truth": str(truth)}
    if not truth.is_dir():
        return where | _against_mesh(run, height_map, truth), None
    motion, reference, names = read_motion(run)
    true = truth_of_views(truth, names)
    _require_same_images(run, truth)
    found = evaluate(
        height_map,
        motion,
        reference,
        true,
        mesh=None if height_map.length_unit == "px" else read_mesh(run / "mesh.ply"),
    )
    put_files({PICTURE: error_picture(height_map, found.heights.error_um)}, output)
    return where | found.figures, output / PICTURE


def _require_same_images(run: Path, truth: Path) -> None:
    """Refuse the truth of other images: simulated series of the same tilts name their images alike."""
    for name, digest in input_digests(run).items():
        path = truth / name
        if digest and path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise BadInputError(
                f"{run} was made from another {name} than the one beside the truth in {truth}; give the folder that "
                "was reconstructed, or reconstruct it again"
            )


def _against_mesh(run: Path, height_map: HeightMap, truth: Path) -> dict[str, Any]:
    if height_map.length_unit != "um":
        raise BadInputError(f"the lengths of {run} are in px and those of {truth} in um; reconstruct with a pixel size")
    mesh, true_mesh = read_mesh(run / "mesh.ply"), read_mesh(truth)
    surface, ours = (make_surface(item.vertices_um, item.faces) for item in (true_mesh, mesh))
    units = Units(height_map.pixel_size_um, float(np.ptp(true_mesh.vertices_um[:, 2])))
    return {
        "length_unit": "um",
        "pixel_size_um": units.pixel_size_um,
        "relief_um": units.relief_um,
        "surface": {kind: surface_figures(ours, surface, kind, units) for kind in ALIGNMENTS},
    }
