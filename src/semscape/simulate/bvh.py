"""Rays against triangles: a bounding-volume hierarchy, and the first hit of each ray.

The hierarchy splits at the median of the longest side of the triangles' centres: balanced, quick to build and free
of parameters. Triangles count from both sides, for many scanned meshes have faces the wrong way round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.types import FloatArray, IntArray

_LEAF = 4
_DEPTH = 64  # 2^64 leaves: no stack grows longer


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Triangles in boxes in boxes.

    Parameters
    ----------
    corners : (F, 3, 3) float array
        First corner and the two edges from it of each triangle, in the order of the leaves.
    face : (F,) int array
        Index of each of these triangles in the mesh.
    boxes : (K, 6) float array
        Lower and upper corner of each node's box.
    child : (K, 2) int array
        Inner node: the two children. Leaf: -1 - the first triangle, and the number of triangles.
    """

    corners: FloatArray
    face: IntArray
    boxes: FloatArray
    child: IntArray


def build_hierarchy(vertices: FloatArray, faces: NDArray[np.integer[Any]]) -> Hierarchy:
    """Build the hierarchy of the triangles `faces` (F, 3) over `vertices` (P, 3).

    Raises
    ------
    ValueError
        Where there is no triangle.
    """
    if not len(faces):
        raise ValueError("a mesh without triangles cannot be imaged")
    triangles = np.ascontiguousarray(vertices[faces], dtype=np.float64)
    order = np.arange(len(faces))
    size = 2 * (2 ** math.ceil(math.log2(max(1.0, len(faces) / _LEAF)) + 1))
    boxes, child = np.empty((size, 6)), np.empty((size, 2), dtype=np.int64)
    used = _build(triangles.mean(axis=1), triangles.min(axis=1), triangles.max(axis=1), order, boxes, child)
    corners = triangles[order]
    corners[:, 1:] -= corners[:, :1]
    return Hierarchy(corners, order, boxes[:used].copy(), child[:used].copy())


@njit(nogil=True, cache=True)
def _build(centre: Any, lower: Any, upper: Any, order: Any, boxes: Any, child: Any) -> int:  # pragma: no cover
    start, stop = np.empty(_DEPTH, dtype=np.int64), np.empty(_DEPTH, dtype=np.int64)
    node_of = np.empty(_DEPTH, dtype=np.int64)
    start[0], stop[0], node_of[0] = 0, order.shape[0], 0
    waiting, used = 1, 1
    while waiting:
        waiting -= 1
        first, last, node = start[waiting], stop[waiting], node_of[waiting]
        widest, axis = -1.0, 0
        for k in range(3):
            low, high, c_low, c_high = np.inf, -np.inf, np.inf, -np.inf
            for n in order[first:last]:
                low, high = min(low, lower[n, k]), max(high, upper[n, k])
                c_low, c_high = min(c_low, centre[n, k]), max(c_high, centre[n, k])
            boxes[node, k], boxes[node, k + 3] = low, high
            if c_high - c_low > widest:
                widest, axis = c_high - c_low, k
        if last - first <= _LEAF:
            child[node, 0], child[node, 1] = -1 - first, last - first
            continue
        # A stable sort keeps the tree, and so the image, the same wherever it is built.
        part = order[first:last]
        order[first:last] = part[np.argsort(centre[part, axis], kind="mergesort")]
        middle = (first + last) // 2
        child[node, 0], child[node, 1] = used, used + 1
        start[waiting], stop[waiting], node_of[waiting] = first, middle, used
        start[waiting + 1], stop[waiting + 1], node_of[waiting + 1] = middle, last, used + 1
        waiting += 2
        used += 2
    return used


def first_hits(
    tree: Hierarchy, origins: FloatArray, directions: FloatArray, start: float, stop: float
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Cast rays.

    Parameters
    ----------
    tree : Hierarchy
        The triangles.
    origins : (N, 3) float array
        A point on each ray.
    directions : (N, 3) or (1, 3) float array
        Directions; one row serves parallel rays.
    start, stop : float
        Part of the rays that is looked at, in lengths of the direction.

    Returns
    -------
    distance : (N,) float array
        Where the first triangle is met, in lengths of the direction; inf where none is.
    face : (N,) int array
        Index of that triangle in the mesh, -1 for none.
    barycentric : (N, 2) float array
        Weights of its second and third corner.
    """
    distance, face, weights = (
        np.empty(len(origins)),
        np.empty(len(origins), dtype=np.int64),
        np.empty((len(origins), 2)),
    )
    _first_hits(
        tree.corners, tree.face, tree.boxes, tree.child, origins, directions, start, stop, distance, face, weights
    )
    return distance, face, weights


@njit(nogil=True, cache=True)
def _enters(boxes: Any, node: int, o: Any, inverse: Any, near: float, far: float) -> float:  # pragma: no cover
    """Return where a ray enters a node's box between near and far, inf where it does not."""
    for k in range(3):
        one, two = (boxes[node, k] - o[k]) * inverse[k], (boxes[node, k + 3] - o[k]) * inverse[k]
        # Comparisons in this order pass over the NaN of a ray that runs within a side of the box.
        if one > two:
            one, two = two, one
        if one > near:
            near = one
        if two < far:
            far = two
    return near if near <= far * (1.0 + 1e-12) + 1e-300 or near <= far else np.inf


@njit(nogil=True, cache=True)
def _first_hits(
    corners: Any, faces: Any, boxes: Any, child: Any, origins: Any, directions: Any, start: float, stop: float,
    distance: Any, face: Any, weights: Any,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    stack, entry = np.empty(_DEPTH, dtype=np.int64), np.empty(_DEPTH)
    o, d, inverse = np.empty(3), np.empty(3), np.empty(3)
    for n in range(origins.shape[0]):
        for k in range(3):
            o[k], d[k] = origins[n, k], directions[min(n, directions.shape[0] - 1), k]
            inverse[k] = 1.0 / d[k] if d[k] != 0.0 else np.inf
        best, best_at, best_v, best_w = stop, -1, 0.0, 0.0
        waiting = 0
        enters = _enters(boxes, 0, o, inverse, start, best)
        if enters < np.inf:
            stack[0], entry[0], waiting = 0, enters, 1
        while waiting:
            waiting -= 1
            if entry[waiting] > best:
                continue
            node = stack[waiting]
            if child[node, 0] < 0:
                first = -1 - child[node, 0]
                for m in range(first, first + child[node, 1]):
                    # Moeller & Trumbore 1997, doi:10.1080/10867651.1997.10487468.
                    ax, ay, az = corners[m, 1, 0], corners[m, 1, 1], corners[m, 1, 2]
                    bx, by, bz = corners[m, 2, 0], corners[m, 2, 1], corners[m, 2, 2]
                    px, py, pz = d[1] * bz - d[2] * by, d[2] * bx - d[0] * bz, d[0] * by - d[1] * bx
                    determinant = ax * px + ay * py + az * pz
                    if determinant == 0.0:
                        continue
                    sx, sy, sz = o[0] - corners[m, 0, 0], o[1] - corners[m, 0, 1], o[2] - corners[m, 0, 2]
                    v = (sx * px + sy * py + sz * pz) / determinant
                    if v < -1e-9 or v > 1.0 + 1e-9:  # a little overlap, so that no ray slips between two triangles
                        continue
                    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
                    w = (d[0] * qx + d[1] * qy + d[2] * qz) / determinant
                    if w < -1e-9 or v + w > 1.0 + 1e-9:
                        continue
                    t = (bx * qx + by * qy + bz * qz) / determinant
                    if start <= t < best:
                        best, best_at, best_v, best_w = t, m, v, w
                continue
            left, right = child[node, 0], child[node, 1]
            to_left, to_right = (
                _enters(boxes, left, o, inverse, start, best),
                _enters(boxes, right, o, inverse, start, best),
            )
            if to_left > to_right:
                left, right, to_left, to_right = right, left, to_right, to_left
            for branch, enters in ((right, to_right), (left, to_left)):
                if enters < np.inf:
                    stack[waiting], entry[waiting] = branch, enters
                    waiting += 1
        distance[n] = best if best_at >= 0 else np.inf
        face[n] = faces[best_at] if best_at >= 0 else -1
        weights[n, 0], weights[n, 1] = best_v, best_w
