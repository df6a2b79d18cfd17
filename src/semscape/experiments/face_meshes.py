"""Faces to take tilt series of: the built-in one, and scanned heads from mesh files as height fields.

A head looks along +z, its forehead along +y. What a beam from the front sees of it, down to a depth, stands on a flat
ground. This module is the one place that turns a mesh into a specimen.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from semscape.io.mesh_file import MESH_SUFFIXES, read_mesh
from semscape.simulate import SimulationOptions, Specimen
from semscape.simulate.series import OVERSAMPLING
from semscape.types import SurfaceMesh

BUILT_IN = "face"
# Shares of the field of view: the height of the head in the image, the depth that is kept, and the whole piece.
_HEAD, _DEPTH, _PIECE = 0.85, 0.3, 1.75
_TEXTURE_SEED = 20160515


def find_faces(data: Path | None) -> dict[str, Path | None]:
    """Return the faces by name: the built-in one without a file, and every mesh of DATA/meshes."""
    folder = None if data is None else data / "meshes"
    files = [] if folder is None or not folder.is_dir() else sorted(folder.iterdir())
    return {BUILT_IN: None} | {path.stem: path for path in files if path.suffix.lower() in MESH_SUFFIXES}


def face_specimen(name: str, path: Path | None, options: SimulationOptions) -> str | Specimen:
    """Return what `simulate` takes of a face, sized for the field of view of the options."""
    if path is None:
        return name
    field_um = options.pixel_size_um * min(options.width_px, options.height_px)
    return head_specimen(name, read_mesh(path), field_um, options.pixel_size_um / OVERSAMPLING)


def head_specimen(name: str, mesh: SurfaceMesh, field_um: float, pitch_um: float) -> Specimen:
    """Return the front of a head as a height field on a flat ground.

    Parameters
    ----------
    name : str
        Name of the specimen.
    mesh : SurfaceMesh
        Closed or open, in any unit, front along +z.
    field_um : float
        Field of view; the head fills most of its height.
    pitch_um : float
        Distance of the nodes.
    """
    used = mesh.vertices_um[np.unique(mesh.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    scale = _HEAD * field_um / (high[1] - low[1])
    vertices = (mesh.vertices_um - (low + high) / 2) * scale
    half = int(np.ceil(_PIECE * field_um / 2 / pitch_um))
    size = 2 * half + 1
    ground = float((high[2] - low[2]) * scale / 2 - _DEPTH * field_um)
    height = np.full((size, size), ground)
    # World x, y to node (col, row), as `Specimen.grid_from_world` has it.
    nodes = np.column_stack([vertices[:, 0] / pitch_um + half, half - vertices[:, 1] / pitch_um, vertices[:, 2]])
    _raise_to_triangles(height, np.ascontiguousarray(nodes[mesh.faces]))
    middle = (height.min() + height.max()) / 2
    return Specimen(name, np.ascontiguousarray(height - middle, dtype=np.float32), pitch_um, _TEXTURE_SEED)


@njit(nogil=True, cache=True)
def _raise_to_triangles(height: Any, triangles: Any) -> None:  # pragma: no cover - compiled
    """Raise `height` (rows, cols) to triangles (F, 3, 3) = (col, row, z): the highest one over each node counts."""
    rows, cols = height.shape
    for t in range(len(triangles)):
        x0, y0, z0 = triangles[t, 0]
        x1, y1, z1 = triangles[t, 1]
        x2, y2, z2 = triangles[t, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12:
            continue
        for r in range(max(0, int(np.ceil(min(y0, y1, y2)))), min(rows - 1, int(max(y0, y1, y2))) + 1):
            for c in range(max(0, int(np.ceil(min(x0, x1, x2)))), min(cols - 1, int(max(x0, x1, x2))) + 1):
                v = ((c - x0) * (y2 - y0) - (x2 - x0) * (r - y0)) / area
                w = ((x1 - x0) * (r - y0) - (c - x0) * (y1 - y0)) / area
                if v >= -1e-9 and w >= -1e-9 and v + w <= 1 + 1e-9:
                    height[r, c] = max(height[r, c], z0 + v * (z1 - z0) + w * (z2 - z0))
