"""Closest points on many triangles: a tree of bounding boxes, exact for every query."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray, IntArray

_LEAF = 4
_DEPTH = 64


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Triangles (F, 3, 3) in the order of the leaves, `order` (F,) into the original ones, and the nodes.

    Node n holds the box `low` to `high` (M, 3) and the triangles `span[n, 0]` to `span[n, 1]`; `child[n]` is the first
    of its two children, which stand side by side, or -1 for a leaf.
    """

    triangles: FloatArray
    order: IntArray
    low: FloatArray
    high: FloatArray
    span: IntArray
    child: IntArray


def make_tree(triangles: FloatArray) -> TriangleTree:
    """Build the tree of triangles (F, 3, 3), F >= 1, by halving along the longest side of the centroids' box."""
    order, span, child, n_nodes = _split(np.ascontiguousarray(triangles.mean(axis=1)))
    span, child = span[:n_nodes], child[:n_nodes]
    ordered = np.ascontiguousarray(triangles[order])
    low, high = np.empty((n_nodes, 3)), np.empty((n_nodes, 3))
    _bound(ordered.min(axis=1), ordered.max(axis=1), span, child, low, high)
    return TriangleTree(ordered, order, low, high, span, child)


def closest_on_triangles(tree: TriangleTree, points: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return for points (N, 3) the closest point (N, 3), its distance (N,) and its row (N,) of `tree.triangles`.

    References
    ----------
    C. Ericson, "Real-Time Collision Detection", Morgan Kaufmann 2005, section 5.1.5 (closest point on a triangle).

    Examples
    --------
    >>> tree = make_tree(np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    >>> foot, distance, index = closest_on_triangles(tree, np.array([[0.25, 0.25, 3.0], [2.0, 0.0, 0.0]]))
    >>> foot.tolist(), distance.tolist()
    ([[0.25, 0.25, 0.0], [1.0, 0.0, 0.0]], [3.0, 1.0])
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    foot, squared = np.empty((len(points), 3)), np.empty(len(points))
    index = np.empty(len(points), dtype=np.int64)
    _query(tree.triangles, tree.low, tree.high, tree.span, tree.child, points, foot, squared, index)
    return foot, np.sqrt(squared), index


@njit(nogil=True, cache=True)
def _split(centroids: Any) -> Any:  # pragma: no cover - compiled
    count = len(centroids)
    order = np.arange(count)
    most = 2 * max(1, (2 * count) // _LEAF + 2)
    span, child = np.empty((most, 2), np.int64), np.full(most, -1, np.int64)
    span[0, 0], span[0, 1] = 0, count
    n_nodes, node = 1, 0
    while node < n_nodes:  # in the order in which the nodes appear: parents before children
        start, stop = span[node]
        if stop - start > _LEAF:
            widest, width = 0, -1.0
            for axis in range(3):
                values = centroids[order[start:stop], axis]
                extent = values.max() - values.min()
                if extent > width:
                    widest, width = axis, extent
            ranked = np.argsort(centroids[order[start:stop], widest], kind="mergesort")
            order[start:stop] = order[start:stop][ranked]
            middle = (start + stop) // 2
            child[node] = n_nodes
            span[n_nodes, 0], span[n_nodes, 1] = start, middle
            span[n_nodes + 1, 0], span[n_nodes + 1, 1] = middle, stop
            n_nodes += 2
        node += 1
    return order, span, child, n_nodes


@njit(nogil=True, cache=True)
def _bound(least: Any, largest: Any, span: Any, child: Any, low: Any, high: Any) -> None:  # pragma: no cover - compiled
    for node in range(len(span) - 1, -1, -1):  # children before parents
        first = child[node]
        for axis in range(3):
            if first < 0:
                low[node, axis] = least[span[node, 0] : span[node, 1], axis].min()
                high[node, axis] = largest[span[node, 0] : span[node, 1], axis].max()
            else:
                low[node, axis] = min(low[first, axis], low[first + 1, axis])
                high[node, axis] = max(high[first, axis], high[first + 1, axis])


@njit(nogil=True, cache=True)
def _to_box(low: Any, high: Any, point: Any) -> float:  # pragma: no cover - compiled
    squared = 0.0
    for axis in range(3):
        beyond = max(low[axis] - point[axis], 0.0, point[axis] - high[axis])
        squared += beyond * beyond
    return squared


@njit(nogil=True, cache=True)
def _query(
    triangles: Any, low: Any, high: Any, span: Any, child: Any, points: Any, foot: Any, squared: Any, index: Any
) -> None:  # pragma: no cover - compiled
    stack, bound = np.empty(_DEPTH * 2, np.int64), np.empty(_DEPTH * 2)
    for n in range(len(points)):
        point = points[n]
        best = np.inf
        top = 1
        stack[0], bound[0] = 0, 0.0
        while top:
            top -= 1
            if bound[top] >= best:
                continue
            node = stack[top]
            first = child[node]
            if first < 0:
                for t in range(span[node, 0], span[node, 1]):
                    x, y, z = _on_triangle(triangles[t], point)
                    away = (x - point[0]) ** 2 + (y - point[1]) ** 2 + (z - point[2]) ** 2
                    if away < best:
                        best, index[n] = away, t
                        foot[n, 0], foot[n, 1], foot[n, 2] = x, y, z
                continue
            near, far = first, first + 1
            to_near, to_far = _to_box(low[near], high[near], point), _to_box(low[far], high[far], point)
            if to_far < to_near:
                near, far, to_near, to_far = far, near, to_far, to_near
            stack[top], bound[top] = far, to_far
            stack[top + 1], bound[top + 1] = near, to_near
            top += 2
        squared[n] = best


@njit(nogil=True, cache=True)
def _on_triangle(triangle: Any, point: Any) -> Any:  # pragma: no cover - compiled
    a, b, c = triangle[0], triangle[1], triangle[2]
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 += ab * (point[i] - a[i])
        d2 += ac * (point[i] - a[i])
        d3 += ab * (point[i] - b[i])
        d4 += ac * (point[i] - b[i])
        d5 += ab * (point[i] - c[i])
        d6 += ac * (point[i] - c[i])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    # Barycentric weights of b and c, from the feature that is closest: a corner, an edge, or the face.
    v = w = 0.0
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        w = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v = d1 / (d1 - d3)
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        w = d2 / (d2 - d6)
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    u = 1.0 - v - w
    return (
        u * a[0] + v * b[0] + w * c[0],
        u * a[1] + v * b[1] + w * c[1],
        u * a[2] + v * b[2] + w * c[2],
    )
