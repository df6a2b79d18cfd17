"""Fewer triangles for a mesh, with the distance to the full one measured, not promised."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from semscape.dense.mesh import height_map_mesh, with_picture
from semscape.errors import BadInputError, NoAnswerError
from semscape.geometry.triangle_tree import TriangleTree, closest_on_triangles, make_tree
from semscape.options import MeshOptions
from semscape.types import FloatArray, HeightMap, IntArray, SurfaceMesh

_FULL_VERTICES = 2_000_000
_FEWEST = 64
_SAMPLES = 200_000
_CLOSE_ENOUGH = 1.05
# The library's "aggressiveness": 7 is its default, 3 halves the error and takes no longer.
_PATIENCE = 3.0
_REACHED = 1.02


@dataclass(frozen=True)
class MeshDistance:
    """Distances between two meshes, both ways, in the meshes' unit."""

    largest: float
    rms: float


def finished_mesh(
    height_map: HeightMap, max_vertices: int, options: MeshOptions
) -> tuple[SurfaceMesh, dict[str, float]]:
    """Return the mesh of a height map as the options want it, with the micrograph on it, and its figures.

    Without a wish for fewer triangles every n-th row and column make at most `max_vertices`. With one, the whole grid
    (thinned to two million vertices) is the mesh that the distances are told to.

    Raises
    ------
    NoAnswerError
        Where no three neighbours are known.
    BadInputError
        Where none are left of those that `max_vertices` keeps.
    """
    figures: dict[str, float] = {}
    if options.triangles or options.error_um:
        mesh = height_map_mesh(height_map, max_vertices=_FULL_VERTICES)
        figures["n_faces_full"] = len(mesh.faces)
        if len(mesh.faces):
            mesh, distance = decimate(mesh, options)
            figures |= {"largest_error": distance.largest, "rms_error": distance.rms}
    else:
        mesh = height_map_mesh(height_map, max_vertices=max_vertices)
    figures |= {"n_vertices": len(mesh.vertices_um), "n_faces": len(mesh.faces)}
    if not len(mesh.faces):
        n_known = int(np.isfinite(height_map.height_um).sum())
        if n_known > max_vertices:
            raise BadInputError(
                f"dense.mesh_max_vertices = {max_vertices} leaves no triangle of {n_known:,} known heights; raise it"
            )
        raise NoAnswerError(
            f"the views agree on the height of no part of the field ({n_known} single pixels are known): check that "
            "the tilts and pixel sizes are those of these images"
        )
    return with_picture(mesh, height_map, options.texture_px), figures


def decimate(mesh: SurfaceMesh, options: MeshOptions) -> tuple[SurfaceMesh, MeshDistance]:
    """Return the mesh with fewer triangles, and its distance to the one given.

    Open borders, at gaps and jumps, are kept as they are, unless they alone have more triangles than wanted.

    Parameters
    ----------
    mesh : SurfaceMesh
        All of the surface's triangles.
    options : MeshOptions
        `triangles`, the number to come down to, or `error_um`, the largest distance (in the mesh's unit) to stay
        within, with as few triangles as that allows. With both, the number holds unless the distance forbids it.

    Returns
    -------
    mesh : SurfaceMesh
        Each vertex has the colour of the nearest old one.
    distance : MeshDistance
        Measured between both meshes, from the vertices of the one to the closest points of the other, and from
        vertices, middles of edges and of triangles back.

    References
    ----------
    Garland & Heckbert 1997, doi:10.1145/258734.258849.

    Examples
    --------
    A flat sheet loses nothing:

    >>> x, y = (axis.ravel().astype(float) for axis in np.meshgrid(np.arange(30), np.arange(30)))
    >>> a = np.arange(870)[np.arange(870) % 30 < 29]
    >>> faces = np.concatenate([np.stack([a, a + 1, a + 30], 1), np.stack([a + 1, a + 31, a + 30], 1)])
    >>> sheet = SurfaceMesh(np.stack([x, y, 0 * x], 1), faces, np.zeros((900, 3), np.uint8), "um")
    >>> fewer, distance = decimate(sheet, MeshOptions(triangles=200))
    >>> len(fewer.faces) <= 200, distance.largest < 1e-9
    (True, True)
    """
    full = make_tree(mesh.vertices_um[mesh.faces])
    within = options.error_um or np.inf
    enough = len(mesh.faces)
    too_few = max(options.triangles, _FEWEST) if options.triangles else _FEWEST
    if too_few >= enough:
        return mesh, MeshDistance(0.0, 0.0)
    best = _fewer(mesh, full, too_few)
    if best[2].largest > within:
        best = mesh.vertices_um, mesh.faces, MeshDistance(0.0, 0.0)
        while enough > _CLOSE_ENOUGH * too_few:
            middle = int(np.sqrt(enough * too_few))
            tried = _fewer(mesh, full, middle)
            if tried[2].largest <= within:
                best, enough = tried, middle
            else:
                too_few = middle
    vertices, faces, distance = best
    _, _, nearest = closest_on_triangles(full, vertices)
    corners = mesh.faces[full.order[nearest]]
    to_corner = np.linalg.norm(mesh.vertices_um[corners] - vertices[:, None], axis=2)
    source = np.take_along_axis(corners, to_corner.argmin(axis=1)[:, None], axis=1)[:, 0]
    return replace(mesh, vertices_um=vertices, faces=faces, color=mesh.color[source]), distance


def _fewer(mesh: SurfaceMesh, full: TriangleTree, count: int) -> tuple[FloatArray, IntArray, MeshDistance]:
    from fast_simplification import simplify

    # Its tolerances are absolute: numbers of the order of one serve any unit.
    centre = mesh.vertices_um.mean(axis=0)
    size = float(np.ptp(mesh.vertices_um, axis=0).max())
    given = (mesh.vertices_um - centre) / size, mesh.faces.copy()  # copies: it takes no read-only array
    vertices, faces = simplify(*given, target_count=count, agg=_PATIENCE, preserve_border=True)
    if len(faces) > _REACHED * count:  # the borders alone have more
        vertices, faces = simplify(*given, target_count=count)
    vertices, faces = np.asarray(vertices, np.float64) * size + centre, np.asarray(faces, np.int64)
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3)
    return vertices, faces, _distance(mesh.vertices_um, full, vertices, faces)


def _distance(points: FloatArray, full: TriangleTree, vertices: FloatArray, faces: IntArray) -> MeshDistance:
    corners = vertices[faces]
    _, there, _ = closest_on_triangles(make_tree(corners), _sample(points))
    middles = (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2
    _, back, _ = closest_on_triangles(full, _sample(np.concatenate([vertices, middles, corners.mean(axis=1)])))
    every = np.concatenate([there, back])
    return MeshDistance(float(every.max()), float(np.sqrt(np.mean(every**2))))


def _sample(points: FloatArray) -> FloatArray:
    return points[:: -(-len(points) // _SAMPLES)]
