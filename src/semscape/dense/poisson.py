"""A closed surface through oriented points: screened Poisson reconstruction on a regular grid.

The indicator of a body, 1 inside and 0 outside, changes at its surface alone, and there along the normal. So its
gradient is known where points with normals are, and the indicator solves a Poisson equation; the screening pulls it to
1/2 at the points (Kazhdan & Hoppe 2013). On a regular grid Fourier transforms solve the plain equation at once, and a
few rounds of conjugate gradients with that as the preconditioner the screened one. The surface is cut out of
tetrahedra, which leaves no hole and no edge with other than two triangles.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from scipy import fft
from scipy.sparse import csr_array

from semscape.dense.oriented_points import OrientedPoints, gradient_source, node_weights
from semscape.types import FloatArray, IntArray

_MARGIN = 0.12
_ROUNDS = 30
_TOLERANCE = 3e-3
# Pull to 1/2 at a point of full weight, against the gradient's, per cell.
_SCREENING = 4.0


def closed_surface(samples: OrientedPoints, cell: float) -> tuple[FloatArray, IntArray]:
    """Return the vertices (P, 3) and faces (F, 3) of a watertight surface through oriented points.

    Parameters
    ----------
    samples : OrientedPoints
        Where a part of the surface is seen several times, the areas must be shared out among the points.
    cell : float
        Distance of the grid's nodes; finer shape is smoothed away. Memory is about 60 bytes a node.

    References
    ----------
    Kazhdan 2005, doi:10.2312/SGP/SGP05/073-082; Kazhdan & Hoppe 2013, doi:10.1145/2487228.2487237; tetrahedra: Doi &
    Koide 1991 (IEICE Transactions E74, 214).

    Examples
    --------
    >>> direction = np.random.default_rng(0).normal(size=(4000, 3))
    >>> direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    >>> ball = OrientedPoints(5 * direction, direction, np.full(4000, 4 * np.pi * 25 / 4000))
    >>> vertices, faces = closed_surface(ball, 0.4)
    >>> radius = np.linalg.norm(vertices, axis=1)
    >>> bool(4.8 < radius.min() and radius.max() < 5.2)
    True
    """
    low, high = samples.points.min(axis=0), samples.points.max(axis=0)
    margin = _MARGIN * float((high - low).max()) + 4 * cell
    shape = tuple(fft.next_fast_len(int(np.ceil(size / cell)) + 1, real=True) for size in high - low + 2 * margin)
    origin = (low + high) / 2 - cell * (np.array(shape) - 1) / 2
    at_points = node_weights((samples.points - origin) / cell, shape)
    indicator = _indicator(samples, at_points, shape, cell)
    level = float(np.average(at_points @ indicator.ravel(), weights=samples.area))
    vertices, faces = level_surface(_outside_at_border(indicator - level))
    return vertices * cell + origin, faces


def _outside_at_border(values: FloatArray) -> FloatArray:
    """Return values (X, Y, Z) that are negative on the border, so that their surface is closed whatever they are."""
    least = -1e-6
    for axis in range(3):
        for end in (0, -1):
            face = np.moveaxis(values, axis, 0)[end]
            np.minimum(face, least, out=face)
    return values


def _indicator(samples: OrientedPoints, at_points: csr_array, shape: tuple[int, ...], cell: float) -> FloatArray:
    """Solve for the indicator on the grid's nodes; lengths are in cells."""
    source, squared = gradient_source(at_points, samples, shape, cell)
    right = fft.irfftn(source, s=shape)
    del source
    area = samples.area / cell**2
    pull = _SCREENING * area
    right += (at_points.T @ (0.5 * pull)).reshape(shape)

    def apply(values: FloatArray) -> FloatArray:
        rough = fft.irfftn(squared * fft.rfftn(values), s=shape)
        screened: FloatArray = rough + (at_points.T @ (pull * (at_points @ values.ravel()))).reshape(shape)
        return screened

    stiffest = squared + _SCREENING * area.sum() / squared.size

    def precondition(values: FloatArray) -> FloatArray:
        solved: FloatArray = fft.irfftn(fft.rfftn(values) / stiffest, s=shape)
        return solved

    found = np.zeros(shape)
    residual = right
    direction = preconditioned = precondition(residual)
    power = first = float(np.vdot(residual, preconditioned))
    for _ in range(_ROUNDS):
        image = apply(direction)
        step = power / float(np.vdot(direction, image))
        found = found + step * direction
        residual = residual - step * image
        preconditioned = precondition(residual)
        power, before = float(np.vdot(residual, preconditioned)), power
        if power < _TOLERANCE**2 * first:
            break
        direction = preconditioned + power / before * direction
    return found


def level_surface(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the surface where a grid (X, Y, Z) is zero: vertices in nodes, faces with the positive side inside.

    It is closed if no positive value lies on the border: every cube is cut into six tetrahedra along one diagonal,
    alike in all cubes, so that neighbours share their faces.

    Examples
    --------
    >>> x, y, z = np.meshgrid(*3 * [np.arange(9.0) - 4], indexing="ij")
    >>> vertices, faces = level_surface(2.5 - np.sqrt(x * x + y * y + z * z))
    >>> edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    >>> bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())
    True
    """
    shape = np.array(values.shape)
    flat = np.where(values == 0, 1e-12, values).ravel()
    inside = (flat > 0).reshape(values.shape)
    corners = [inside[tuple(slice(c, c - 1 or None) for c in corner)] for corner in np.ndindex(2, 2, 2)]
    count = np.sum(corners, axis=0, dtype=np.int8)
    cubes = np.argwhere((count > 0) & (count < 8))
    stride = np.array([shape[1] * shape[2], shape[2], 1])
    base = cubes @ stride
    triangles = []
    for order in permutations(range(3)):
        # From the first corner to the opposite one along the three axes in some order.
        offsets = np.concatenate([[0], np.cumsum(stride[list(order)])])
        triangles += _cut(base[:, None] + offsets, flat)
    edges = np.concatenate(triangles)
    low, high = edges.min(axis=2), edges.max(axis=2)
    keys, faces = np.unique(low.ravel() * flat.size + high.ravel(), return_inverse=True)
    one, two = keys // flat.size, keys % flat.size
    share = flat[one] / (flat[one] - flat[two])
    first, second = (np.column_stack(np.unravel_index(node, values.shape)) for node in (one, two))
    vertices = first + share[:, None] * (second - first)
    return vertices, _facing_out(vertices, faces.reshape(-1, 3), edges, flat, values.shape)


def _cut(tetrahedra: IntArray, values: FloatArray) -> list[IntArray]:
    """Return the triangles (F, 3, 2) of tetrahedra (T, 4): each corner is the edge, as two nodes, that it lies on."""
    positive = values[tetrahedra] > 0
    count = positive.sum(axis=1)
    # Those inside first, else in order: then the cases are three.
    ordered = np.take_along_axis(tetrahedra, np.argsort(~positive, axis=1, kind="stable"), axis=1)
    found = []
    for inside, corners in (
        (1, ((0, 1), (0, 2), (0, 3))),
        (3, ((0, 3), (1, 3), (2, 3))),
        (2, ((0, 2), (0, 3), (1, 2))),
        (2, ((1, 2), (0, 3), (1, 3))),
    ):
        found.append(ordered[count == inside][:, np.array(corners)])
    return found


def _facing_out(
    vertices: FloatArray, faces: IntArray, edges: IntArray, values: FloatArray, shape: tuple[int, ...]
) -> IntArray:
    """Turn faces (F, 3) so that they run counter-clockwise seen from the negative side."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    outer = np.where(values[edges[:, :, 0]] > 0, edges[:, :, 1], edges[:, :, 0])
    inner = edges.sum(axis=2) - outer
    out, within = (np.stack(np.unravel_index(nodes, shape), axis=-1).sum(axis=1) for nodes in (outer, inner))
    wrong = np.einsum("fk,fk->f", normal, (out - within).astype(np.float64)) < 0
    turned: IntArray = np.where(wrong[:, None], faces[:, ::-1], faces)
    return turned
