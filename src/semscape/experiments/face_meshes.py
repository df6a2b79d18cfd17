"""Faces to take tilt series of: the built-in one, and scanned heads from mesh files.

A head looks along +z, its forehead along +y, and lies in a flat ground up to a depth behind the tip of its nose.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from semscape.io.mesh_file import MESH_SUFFIXES, read_mesh
from semscape.simulate import SimulationOptions
from semscape.simulate.mesh import MeshSpecimen
from semscape.types import SurfaceMesh

BUILT_IN = "face"
# Shares of the field of view: the height of the head in the image, the depth that is kept, and the side of the ground.
_HEAD, _DEPTH, _GROUND = 0.85, 0.3, 2.2
_TEXTURE_SEED = 20160515


def find_faces(data: Path | None) -> dict[str, Path | None]:
    """Return the faces by name: the built-in one without a file, and every mesh of DATA/meshes."""
    folder = None if data is None else data / "meshes"
    files = [] if folder is None or not folder.is_dir() else sorted(folder.iterdir())
    return {BUILT_IN: None} | {path.stem: path for path in files if path.suffix.lower() in MESH_SUFFIXES}


def face_specimen(name: str, path: Path | None, options: SimulationOptions) -> str | MeshSpecimen:
    """Return what `simulate` takes of a face, sized for the field of view of the options."""
    if path is None:
        return name
    return head_specimen(name, read_mesh(path), options.pixel_size_um * min(options.width_px, options.height_px))


def head_specimen(name: str, mesh: SurfaceMesh, field_um: float) -> MeshSpecimen:
    """Return the front of a head in a flat ground, overhangs and all.

    Parameters
    ----------
    name : str
        Name of the specimen.
    mesh : SurfaceMesh
        Closed or open, in any unit, front along +z.
    field_um : float
        Field of view; the head fills most of its height.
    """
    used = mesh.vertices_um[np.unique(mesh.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    scale = _HEAD * field_um / (high[1] - low[1])
    # The tip of the nose and the ground lie at equal distances from the eucentric plane.
    vertices = (mesh.vertices_um - [*(low + high)[:2] / 2, high[2]]) * scale + [0, 0, _DEPTH * field_um / 2]
    ground = -_DEPTH * field_um / 2
    seen = mesh.faces[vertices[mesh.faces, 2].max(axis=1) > ground]
    half = _GROUND * field_um / 2
    corners = np.array([[-half, -half, ground], [half, -half, ground], [half, half, ground], [-half, half, ground]])
    square = len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    return MeshSpecimen(name, np.vstack([vertices, corners]), np.vstack([seen, square]), _TEXTURE_SEED)
