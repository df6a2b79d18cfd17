"""The motion's reprojection error with the structure eliminated.

For the tracks seen in the same m views, with C the scatter of their centred 2m-vectors of image coordinates
and M the stacked 2m x 3 camera rows, the least reprojection error over all points is
E(M) = trace((I - M M^+) C). Its cost does not depend on the number of tracks, so that a whole population of
motions is scored at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from semscape.geometry.rotations import tilted_cam_from_world
from semscape.types import FloatArray, IntArray, Observations


@dataclass(frozen=True)
class PatternScatters:
    """Scatter matrices by visibility pattern, L patterns over V views.

    `views` (L, V) holds the pattern's view indices in its first `n_views[l]` columns, `scatter` (L, 2V, 2V)
    px^2 in its first 2 `n_views[l]` rows and columns.
    """

    views: IntArray
    n_views: IntArray
    scatter: FloatArray


def pattern_scatters(observations: Observations, n_views: int, track_weight: FloatArray) -> PatternScatters:
    """Collect the scatter matrices of all visibility patterns.

    Parameters
    ----------
    observations : Observations
        Sorted by point, then view.
    n_views : int
        Number of views V of the series.
    track_weight : (P,) float array
        Weight of each track; 0 leaves it out.
    """
    start = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
    seen = np.zeros((observations.n_points, n_views), dtype=bool)
    seen[observations.point, observations.view] = True
    patterns, pattern_of = np.unique(seen, axis=0, return_inverse=True)
    views = np.zeros((len(patterns), n_views), dtype=np.int64)
    counts = patterns.sum(axis=1)
    scatter = np.zeros((len(patterns), 2 * n_views, 2 * n_views))
    for index, pattern in enumerate(patterns):
        m = counts[index]
        views[index, :m] = np.flatnonzero(pattern)
        points = np.flatnonzero(pattern_of == index)
        weight = track_weight[points]
        if weight.sum() <= 0:
            continue
        w = observations.xy[start[points][:, None] + np.arange(m)].reshape(len(points), 2 * m)
        deviation = w - (weight @ w) / weight.sum()
        scatter[index, : 2 * m, : 2 * m] = (deviation * weight[:, None]).T @ deviation
    return PatternScatters(views, counts.astype(np.int64), scatter)


def projection_matrices(parameters: FloatArray, scale_px_per_um: FloatArray) -> FloatArray:
    """Return (N, V, 2, 3) camera matrices in px per um.

    Parameters
    ----------
    parameters : (N, 1 + 4 V) float array
        Axis angle, then per view tilt, roll, relative scale, anisotropy.
    scale_px_per_um : (V,) float array
        Nominal scales.
    """
    axis = parameters[:, 0]
    tilt, roll = parameters[:, 1::4], parameters[:, 2::4]
    scale = scale_px_per_um * (1 + parameters[:, 3::4])
    stretch = np.stack([1 + parameters[:, 4::4] / 2, 1 - parameters[:, 4::4] / 2], axis=-1)
    rotation = tilted_cam_from_world(axis[:, None], tilt, roll)
    matrices: FloatArray = stretch[..., None] * scale[..., None, None] * rotation[..., :2, :]
    return matrices


def eliminated_cost(matrices: FloatArray, patterns: PatternScatters) -> FloatArray:
    """Return E summed over all patterns, (N,) px^2, for N motions given as (N, V, 2, 3) camera matrices.

    References
    ----------
    Golub & Pereyra 1973, doi:10.1137/0710036 (variable projection); Tomasi & Kanade 1992,
    doi:10.1007/BF00129684.
    """
    cost = np.empty(len(matrices))
    _eliminated_cost(np.ascontiguousarray(matrices), patterns.views, patterns.n_views, patterns.scatter, cost)
    return cost


@njit(cache=True, nogil=True)
def _eliminated_cost(
    matrices: FloatArray, views: IntArray, n_views: IntArray, scatter: FloatArray, cost: FloatArray
) -> None:
    stacked = np.empty((2 * views.shape[1], 3))
    product = np.empty((2 * views.shape[1], 3))
    for member in range(len(matrices)):
        total = 0.0
        for pattern in range(len(views)):
            rows = 2 * n_views[pattern]
            for row in range(rows):
                for axis in range(3):
                    stacked[row, axis] = matrices[member, views[pattern, row // 2], row % 2, axis]
            a00 = a01 = a02 = a11 = a12 = a22 = 0.0
            trace = 0.0
            for row in range(rows):
                x, y, z = stacked[row]
                a00, a01, a02 = a00 + x * x, a01 + x * y, a02 + x * z
                a11, a12, a22 = a11 + y * y, a12 + y * z, a22 + z * z
                trace += scatter[pattern, row, row]
                sx = sy = sz = 0.0
                for column in range(rows):
                    value = scatter[pattern, row, column]
                    sx += value * stacked[column, 0]
                    sy += value * stacked[column, 1]
                    sz += value * stacked[column, 2]
                product[row, 0], product[row, 1], product[row, 2] = sx, sy, sz
            # Equal tilts make the 3 x 3 matrix singular: then depth explains nothing, which a ridge expresses.
            ridge = 1e-10 * (a00 + a11 + a22)
            a00, a11, a22 = a00 + ridge, a11 + ridge, a22 + ridge
            c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
            c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
            determinant = a00 * c00 + a01 * c01 + a02 * c02
            explained = 0.0
            for row in range(rows):
                x, y, z = stacked[row]
                px, py, pz = product[row, 0], product[row, 1], product[row, 2]
                explained += x * (c00 * px + c01 * py + c02 * pz)
                explained += y * (c01 * px + c11 * py + c12 * pz)
                explained += z * (c02 * px + c12 * py + c22 * pz)
            total += trace - explained / determinant
        cost[member] = total
