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

    Parts are joined into one; textures and colours are not read. Vertices that differ in texture coordinates alone
    become one, and a closed surface that is inside out is turned.

    Raises
    ------
    BadInputError
        If the file cannot be read, is of another kind, or holds no surface.
    """
    import trimesh

    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise BadInputError(f"{path} is not a mesh file that is read; there are: {', '.join(MESH_SUFFIXES)}")
    load: Any = trimesh.load_mesh  # trimesh does not type it
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of materials and textures, which are not read
            mesh = load(path, skip_materials=True)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        if mesh.is_watertight and mesh.volume < 0:
            mesh.invert()
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # the readers of five formats raise what they like
        raise BadInputError(f"{path} cannot be read as a mesh: {type(error).__name__}: {error}") from error
    if not len(faces) or not np.isfinite(vertices).all() or not np.ptp(vertices[:, :2], axis=0).all():
        raise BadInputError(f"{path} holds no surface: {len(faces)} triangles over {len(vertices)} points")
    return SurfaceMesh(vertices, faces, np.full((len(vertices), 3), _GREY, np.uint8), "um")
