"""How a body is closed where no view has seen it: about where a lid on the opening would lie.

Poisson reconstruction alone closes an open surface with a bulge or a dent, for it wants 1/2 on the average of the
points that it is given, those beside the opening included. The winding number, the solid angle of the surface over
4 pi, knows better: 1/2 in the plane of a flat rim, whatever stands above it. Where it is 1/2 away from all points,
points are added.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from semscape.dense.oriented_points import OrientedPoints, gradient_source, node_weights
from semscape.dense.poisson import level_surface
from semscape.types import FloatArray

_MOST_NODES = 1_500_000
# Far from the body nothing of its images in the neighbouring periods may be left.
_MARGIN = 1.0
# Across the surface the winding number changes over so many nodes on either side; nearer than this nothing is added.
_ACROSS = 2.0
_BESIDE = 2.0
# Over so many nodes points share the area of the surface, if they stand no more thinly than this.
_SPREAD = 1.5
_LEAST_DENSITY = 0.2


def closing_points(samples: OrientedPoints, cell: float) -> OrientedPoints:
    """Return oriented points, `cell` apart, on the surface that closes an open one.

    References
    ----------
    Jacobson, Kavan & Sorkine-Hornung 2013, doi:10.1145/2461912.2461916.

    Examples
    --------
    The upper half of a ball of radius 20 is closed by a disc, but for three nodes of the grid, 1 apart:

    >>> direction = np.random.default_rng(0).normal(size=(20_000, 3))
    >>> direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    >>> upper = 20 * direction[direction[:, 2] > 0]
    >>> half = OrientedPoints(upper, upper / 20, np.full(len(upper), 2 * np.pi * 20**2 / len(upper)))
    >>> disc = closing_points(half, 0.5)
    >>> inner = disc.points[np.hypot(*disc.points[:, :2].T) < 15]
    >>> bool(np.abs(inner[:, 2]).max() < 3), bool((disc.normals[:, 2] < -0.9).mean() > 0.9)
    (True, True)
    """
    low, high = samples.points.min(axis=0), samples.points.max(axis=0)
    size = high - low + 2 * _MARGIN * float((high - low).max())
    coarse = max(cell, float(np.cbrt(size.prod() / _MOST_NODES)))
    shape = tuple(fft.next_fast_len(int(np.ceil(length / coarse)) + 1, real=True) for length in size)
    origin = (low + high) / 2 - coarse * (np.array(shape) - 1) / 2
    at_points = node_weights((samples.points - origin) / coarse, shape)
    samples = _evenly_dense(samples, at_points, shape, coarse)
    winding = _winding_number(at_points, samples, shape, coarse)
    inner, outer = (
        node_weights((samples.points + side * _ACROSS * coarse * samples.normals - origin) / coarse, shape)
        @ winding.ravel()
        for side in (-1, 1)
    )
    # Where points stand less densely than told, the number changes by less than 1.
    vertices, faces = level_surface(winding - np.median(inner - outer) / 2)
    corners = vertices[faces] * coarse + origin
    return _spread(corners[_far(corners.mean(axis=1), samples.points, _BESIDE * coarse)], cell)


def _evenly_dense(
    samples: OrientedPoints, at_points: csr_array, shape: tuple[int, ...], coarse: float
) -> OrientedPoints:
    """Share out the area of the surface anew: at its rim, and where maps disagree, points stand thinly."""
    spread = gaussian_filter((at_points.T @ (samples.area / coarse**2)).reshape(shape), _SPREAD)
    # Of a plane with as much area of points as of plane; interpolation blurs by a variance of 1/6 in and out.
    of_plane = 1 / np.sqrt(2 * np.pi * (_SPREAD**2 + 1 / 3))
    density = (at_points @ spread.ravel()) / of_plane
    return replace(samples, area=samples.area / np.maximum(density, _LEAST_DENSITY))


def _winding_number(at_points: csr_array, samples: OrientedPoints, shape: tuple[int, ...], coarse: float) -> FloatArray:
    """Return the winding number on a grid's nodes, 0 far away."""
    source, squared = gradient_source(at_points, samples, shape, coarse)
    squared[0, 0, 0] = 1.0
    found: FloatArray = fft.irfftn(source / squared, s=shape)
    border = np.ones(shape, np.bool_)
    border[1:-1, 1:-1, 1:-1] = False
    found -= found[border].mean()
    return found


def _far(places: FloatArray, points: FloatArray, distance: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    nearest, _ = cKDTree(points).query(places, distance_upper_bound=distance)
    far: np.ndarray[tuple[int], np.dtype[np.bool_]] = np.isinf(nearest)
    return far


def _spread(corners: FloatArray, cell: float) -> OrientedPoints:
    """Return points on triangles (F, 3, 3), the middles of equal parts of about `cell`."""
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    parts = max(1, int(np.ceil(edges.max() / cell))) if len(corners) else 1
    one, two = np.indices((parts, parts)).reshape(2, -1)
    upright = one + two < parts
    share = np.stack([one, two], axis=1)[upright] + 1 / 3
    inverted = np.stack([one, two], axis=1)[one + two < parts - 1] + 2 / 3
    share = np.concatenate([share, inverted]) / parts
    share = np.column_stack([share, 1 - share.sum(axis=1)])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.maximum(np.linalg.norm(across, axis=1), 1e-300)
    count = len(share)
    return OrientedPoints(
        np.einsum("sk,fki->fsi", share, corners).reshape(-1, 3),
        np.repeat(across / twice[:, None], count, axis=0),
        np.repeat(twice / 2 / count, count),
    )
