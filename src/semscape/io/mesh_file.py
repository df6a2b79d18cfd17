"""Triangle meshes of others: PLY, OBJ, STL, OFF and GLB."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from semscape.errors import BadInputError
from semscape.types import SurfaceMesh

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb")
_GREY = 200


def read_mesh(path: Path | str) -> SurfaceMesh:
    """Read a triangle mesh; its numbers are taken as um, z up.

    Parts are joined into one; textures and colours are not read.

    Raises
    ------
    BadInputError
        If the file cannot be read, is of another kind, or holds no triangle.
    """
    import trimesh

    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise BadInputError(f"{path} is not a mesh file that is read; there are: {', '.join(MESH_SUFFIXES)}")
    load: Any = trimesh.load_mesh  # trimesh does not type it
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of materials and textures, which are not read
            mesh = load(path, process=False, maintain_order=True, skip_materials=True)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:
        raise BadInputError(f"the mesh {path} cannot be read: {error}") from error
    if not len(faces):
        raise BadInputError(f"the mesh {path} holds no triangles; a cloud of points has no surface to compare with")
    return SurfaceMesh(vertices, faces, np.full((len(vertices), 3), _GREY, np.uint8), "um")
