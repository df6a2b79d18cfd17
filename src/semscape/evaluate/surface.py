"""A triangulated surface that can be asked for its closest points, and for samples spread over it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from trimesh.remesh import subdivide_to_size

from semscape.geometry.triangle_tree import TriangleTree, closest_on_triangles, make_tree
from semscape.types import BoolArray, FloatArray, IntArray

_CELLS = 100_000
_MAX_SUBDIVISIONS = 40


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles, none of them large, with a search tree, in its order: neighbours stand close to each other.

    `centroids` (F, 3) in um, `normals` (F, 3) of unit length, `area` (F,) in um^2, `counted` (F,) bool: whether a
    result is expected to hold this piece.
    """

    centroids: FloatArray
    normals: FloatArray
    area: FloatArray
    counted: BoolArray
    tree: TriangleTree


@dataclass(frozen=True, eq=False)
class Foot:
    """Closest points on a surface: `points` (N, 3), `distance` (N,) and the `normals` (N, 3) of their triangles."""

    points: FloatArray
    distance: FloatArray
    normals: FloatArray


def make_surface(vertices: FloatArray, faces: IntArray, counted: BoolArray | None = None) -> Surface:
    """Return a surface for comparisons; large triangles are divided, those without area left out.

    Parameters
    ----------
    vertices : (P, 3) float array
        In um.
    faces : (F, 3) int array
        Counter-clockwise from outside.
    counted : (F,) bool array, optional
        Faces that a result is expected to hold; all where left out.

    Raises
    ------
    ValueError
        If no triangle has an area.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> square = make_surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    >>> round(float(square.area.sum()), 9), len(square.area) > 10_000
    (1.0, True)
    """
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    counted = np.ones(len(faces), dtype=np.bool_) if counted is None else counted
    area = _normals_and_area(vertices[faces])[1]
    if not (len(faces) and area.sum() > 0):
        raise ValueError("a surface without a triangle that has an area cannot be compared")
    # Pieces of about one size are samples that cover the whole surface, whatever the sizes of the mesh's triangles.
    edge = 2 * float(np.sqrt(2 * area.sum() / _CELLS))
    divide: Any = subdivide_to_size  # trimesh does not type it
    vertices, faces, origin = divide(vertices, faces, max_edge=edge, max_iter=_MAX_SUBDIVISIONS, return_index=True)
    triangles = vertices[faces]
    normals, area = _normals_and_area(triangles)
    solid = np.flatnonzero(area > 0)
    tree = make_tree(triangles[solid])
    order = solid[tree.order]
    return Surface(tree.triangles.mean(axis=1), normals[order], area[order], counted[origin][order], tree)


def closest(surface: Surface, points: FloatArray) -> Foot:
    """Return the closest points of a surface to `points` (N, 3)."""
    foot, distance, index = closest_on_triangles(surface.tree, points)
    return Foot(foot, distance, surface.normals[index])


def _normals_and_area(triangles: FloatArray) -> tuple[FloatArray, FloatArray]:
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    twice_area = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(twice_area, 1e-300)[:, None], twice_area / 2
