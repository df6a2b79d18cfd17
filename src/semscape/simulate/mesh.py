"""Triangle meshes as specimens: whole surfaces with overhangs, and how their normals run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from semscape.types import FloatArray, IntArray

_CREASE_DEG = 35.0
_MAX_SPLITS = 40
_MAX_FACES = 3_000_000


@dataclass(frozen=True, eq=False)
class MeshSpecimen:
    """Triangles in the world's frame, z towards the electron source.

    `vertices_um` (P, 3), `faces` (F, 3), counter-clockwise from outside. `texture_seed` fixes the material texture,
    3D noise at the surface's points.
    """

    name: str
    vertices_um: FloatArray
    faces: IntArray
    texture_seed: int = 0


def smooth_between_creases(
    vertices: FloatArray, faces: NDArray[np.integer[Any]]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Split vertices at creases, so that each has one normal.

    Two faces share the normal at a vertex where a chain of faces joins them, each turned against the next by
    less than 35 deg.

    Returns
    -------
    vertices : (Q, 3) float array
        Vertices, once for each smooth piece of surface they lie on.
    normals : (Q, 3) float array
        Unit normals, the mean of the faces' by area.
    faces : (F, 3) int array
        The same triangles over these vertices; those without an area are left out.
    """
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(area, axis=1)
    kept = size > 0
    faces, area, normal = np.asarray(faces[kept], dtype=np.int64), area[kept], area[kept] / size[kept, None]
    count = len(faces)
    # Edges by their vertices in rising order; equal neighbours in the sorted list belong to adjacent faces.
    begin, end = faces, np.roll(faces, -1, axis=1)
    key = (np.minimum(begin, end) * len(vertices) + np.maximum(begin, end)).ravel()
    face = np.repeat(np.arange(count), 3)
    order = np.argsort(key, kind="stable")
    one, two = order[:-1], order[1:]
    same = key[one] == key[two]
    one, two = one[same], two[same]
    gentle = np.einsum("nk,nk->n", normal[face[one]], normal[face[two]]) > math.cos(math.radians(_CREASE_DEG))
    one, two = one[gentle], two[gentle]
    # A half-edge n runs from corner n to the next corner of its face.
    after = np.arange(3 * count).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    flat = faces.ravel()
    against = flat[one] == flat[after[two]]  # consistently wound neighbours run along their edge in opposite senses
    links_one = np.concatenate([one, after[one]])
    links_two = np.concatenate([np.where(against, after[two], two), np.where(against, two, after[two])])
    links = coo_array((np.ones(len(links_one)), (links_one, links_two)), shape=(3 * count, 3 * count))
    n_vertices, vertex = connected_components(links, directed=False)
    source = np.empty(n_vertices, dtype=np.int64)
    source[vertex] = flat
    normals = np.empty((n_vertices, 3))
    for k in range(3):
        normals[:, k] = np.bincount(vertex, weights=area[face, k], minlength=n_vertices)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    return vertices[source], normals, vertex.reshape(-1, 3).astype(np.int64)


def refine(
    vertices: FloatArray, normals: FloatArray, faces: IntArray, longest_um: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Halve triangles across their longest edge until none is longer than `longest_um`; no shape changes.

    What the signal interpolates over a triangle, like the open sky, then changes little within it. It stops at three
    million triangles.
    """
    for _ in range(_MAX_SPLITS):
        edge = vertices[np.roll(faces, -1, axis=1)] - vertices[faces]
        length = np.sqrt(np.einsum("fek,fek->fe", edge, edge))
        longest = np.argmax(length, axis=1)
        split = np.flatnonzero(length[np.arange(len(faces)), longest] > longest_um)
        if not len(split) or len(faces) + len(split) > _MAX_FACES:
            break
        at = longest[split]
        a, b, c = (faces[split, (at + k) % 3] for k in range(3))
        pairs, middle = np.unique(np.sort(np.column_stack([a, b]), axis=1), axis=0, return_inverse=True)
        middle = middle.ravel() + len(vertices)
        between = normals[pairs].sum(axis=1)
        between /= np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-12)
        vertices, normals = np.vstack([vertices, vertices[pairs].mean(axis=1)]), np.vstack([normals, between])
        faces = faces.copy()
        faces[split] = np.column_stack([a, middle, c])
        faces = np.vstack([faces, np.column_stack([middle, b, c])])
    return vertices, normals, faces


def hemisphere(count: int) -> FloatArray:
    """Return unit vectors (count, 3) over the upper hemisphere, distributed as the cosine to +z."""
    index = np.arange(count) + 0.5
    radius = np.sqrt(index / count)
    azimuth = index * math.pi * (3.0 - math.sqrt(5.0))
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1.0 - index / count)])
