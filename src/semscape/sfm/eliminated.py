"""The motion's reprojection error with the structure eliminated.

For the tracks seen in the same m views, with C the scatter of their centred 2m-vectors of image coordinates
and M the stacked 2m x 3 camera rows, the least reprojection error over all points is
E(M) = trace((I - M M^+) C). Its cost does not depend on the number of tracks, so that a whole population of
motions is scored at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray, IntArray, Observations

# Members of a population that are worked on side by side: lanes of the machine's vector unit.
_LANES = 16
_RIDGE = 1e-10
_VIEWS_PER_CODE = 32


@dataclass(frozen=True)
class PatternScatters:
    """Scatter matrices by visibility pattern, L patterns over V views.

    `views` (L, V) holds the pattern's view indices in its first `n_views[l]` columns, `scatter` (L, 2V, 2V)
    px^2 in its first 2 `n_views[l]` rows and columns, `n_tracks` (L,) how many tracks have the pattern.
    """

    views: IntArray
    n_views: IntArray
    scatter: FloatArray
    n_tracks: IntArray

    def strongest(self, most: int) -> PatternScatters:
        """Return the `most` patterns that hold most, and for each view that they leave out the best one that has it.

        A search needs no more: 7 views can make 120 patterns, of which a few hold nearly all that the tracks tell.
        """
        order = np.argsort(-self.n_tracks * (2 * self.n_views - 3), kind="stable")
        members = [set(views[:count].tolist()) for views, count in zip(self.views, self.n_views, strict=True)]
        chosen = order[:most].tolist()
        for view in range(self.views.shape[1]):
            if not any(view in members[index] for index in chosen):
                chosen += [index for index in order if view in members[index]][:1]
        kept = np.array(sorted(chosen))
        return PatternScatters(self.views[kept], self.n_views[kept], self.scatter[kept], self.n_tracks[kept])


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
    groups = list(_by_pattern(observations, n_views))
    views = np.zeros((len(groups), n_views), dtype=np.int64)
    counts, tracks = np.zeros((2, len(groups)), dtype=np.int64)
    scatter = np.zeros((len(groups), 2 * n_views, 2 * n_views))
    for index, (seen, points, w) in enumerate(groups):
        m = counts[index] = len(seen)
        views[index, :m] = seen
        weight = track_weight[points]
        tracks[index] = np.count_nonzero(weight)
        if tracks[index]:
            deviation = w - (weight @ w) / weight.sum()
            scatter[index, : 2 * m, : 2 * m] = (deviation * weight[:, None]).T @ deviation
    return PatternScatters(views, counts, scatter, tracks)


def track_residuals(observations: Observations, matrices: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return each track's summed squared residuals (P,) px^2, its point eliminated, and how many are free (P,).

    Parameters
    ----------
    observations : Observations
        Sorted by point, then view.
    matrices : (V, 2, 3) float array
        Camera matrices; the translations are taken from the medians of each visibility pattern.
    """
    squared = np.zeros(observations.n_points)
    n_free = np.zeros(observations.n_points, dtype=np.int64)
    for seen, points, w in _by_pattern(observations, len(matrices)):
        basis, *_ = np.linalg.svd(matrices[seen].reshape(-1, 3), full_matrices=False)
        deviation = w - np.median(w, axis=0)
        deviation = deviation - deviation @ basis @ basis.T
        squared[points] = (deviation**2).sum(axis=1)
        n_free[points] = 2 * len(seen) - 3
    return squared, n_free


def _by_pattern(observations: Observations, n_views: int) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
    """Yield for each visibility pattern its views (m,), its points (n,) and their coordinates (n, 2 m)."""
    start = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
    visible = np.zeros((observations.n_points, n_views), dtype=bool)
    visible[observations.point, observations.view] = True
    pattern_of = np.zeros(observations.n_points, dtype=np.int64)
    example = np.zeros(1, dtype=np.int64)
    for first in range(0, n_views, _VIEWS_PER_CODE):
        chunk = visible[:, first : first + _VIEWS_PER_CODE]
        bits = 2 ** np.arange(chunk.shape[1], dtype=np.int64)[::-1]
        _, example, pattern_of = np.unique(
            pattern_of * 2 ** chunk.shape[1] + chunk @ bits, return_index=True, return_inverse=True
        )
    order = np.argsort(pattern_of, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(pattern_of))[:-1])
    for pattern, points in zip(visible[example], groups, strict=True):
        m = int(pattern.sum())
        yield np.flatnonzero(pattern), points, observations.xy[start[points][:, None] + np.arange(m)].reshape(-1, 2 * m)


def projection_matrices(parameters: FloatArray, scale_px_per_um: FloatArray) -> FloatArray:
    """Return (N, V, 2, 3) camera matrices in px per um.

    Parameters
    ----------
    parameters : (N, 1 + 4 V) float array
        Axis angle, then per view tilt, roll, relative scale, anisotropy.
    scale_px_per_um : (V,) float array
        Nominal scales.
    """
    matrices = np.empty((len(parameters), len(scale_px_per_um), 2, 3))
    _project(np.ascontiguousarray(parameters), np.ascontiguousarray(scale_px_per_um), matrices)
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
def _project(parameters: FloatArray, scale: FloatArray, matrices: FloatArray) -> None:
    """Write stretch scale Rz(roll) R_0 Rot(axis, tilt), its first two rows, as geometry.rotations has it."""
    for member in range(len(parameters)):
        ax, ay = np.cos(parameters[member, 0]), np.sin(parameters[member, 0])
        for view in range(len(scale)):
            tilt, roll, drift, anisotropy = parameters[member, 1 + 4 * view : 5 + 4 * view]
            c, s = np.cos(tilt), np.sin(tilt)
            rc, rs = np.cos(roll), np.sin(roll)
            t = 1 - c
            xx, xy, xz = c + ax * ax * t, ax * ay * t, ay * s
            yx, yy, yz = -ax * ay * t, -c - ay * ay * t, ax * s
            size = scale[view] * (1 + drift)
            across, down = size * (1 + anisotropy / 2), size * (1 - anisotropy / 2)
            matrices[member, view, 0, 0] = across * (rc * xx - rs * yx)
            matrices[member, view, 0, 1] = across * (rc * xy - rs * yy)
            matrices[member, view, 0, 2] = across * (rc * xz - rs * yz)
            matrices[member, view, 1, 0] = down * (rs * xx + rc * yx)
            matrices[member, view, 1, 1] = down * (rs * xy + rc * yy)
            matrices[member, view, 1, 2] = down * (rs * xz + rc * yz)


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminated_cost(
    matrices: FloatArray, views: IntArray, n_views: IntArray, scatter: FloatArray, cost: FloatArray
) -> None:
    """Score the members in blocks, a lane each, so that no sum depends on its neighbours.

    With M^T C M = S + S^T, where S takes the upper half of the symmetric C, half the products are saved.
    """
    rows_of_all = 2 * matrices.shape[1]
    m = np.empty((rows_of_all, 3, _LANES))
    gram = np.empty((6, _LANES))
    inner = np.empty((6, _LANES))
    u = np.empty((3, _LANES))
    total = np.empty(_LANES)
    for first in range(0, len(matrices), _LANES):
        lanes = min(_LANES, len(matrices) - first)
        for row in range(rows_of_all):
            for axis in range(3):
                for lane in range(_LANES):
                    m[row, axis, lane] = matrices[first + min(lane, lanes - 1), row // 2, row % 2, axis]
        total[:] = 0.0
        for pattern in range(len(views)):
            rows = 2 * n_views[pattern]
            gram[:] = 0.0
            inner[:] = 0.0
            trace = 0.0
            for row in range(rows):
                r = 2 * views[pattern, row // 2] + row % 2
                value = scatter[pattern, row, row]
                trace += value
                for axis in range(3):
                    for lane in range(_LANES):
                        u[axis, lane] = 0.5 * value * m[r, axis, lane]
                for column in range(row + 1, rows):
                    c = 2 * views[pattern, column // 2] + column % 2
                    value = scatter[pattern, row, column]
                    for axis in range(3):
                        for lane in range(_LANES):
                            u[axis, lane] += value * m[c, axis, lane]
                for lane in range(_LANES):
                    x, y, z = m[r, 0, lane], m[r, 1, lane], m[r, 2, lane]
                    ux, uy, uz = u[0, lane], u[1, lane], u[2, lane]
                    gram[0, lane] += x * x
                    gram[1, lane] += x * y
                    gram[2, lane] += x * z
                    gram[3, lane] += y * y
                    gram[4, lane] += y * z
                    gram[5, lane] += z * z
                    inner[0, lane] += x * ux
                    inner[1, lane] += x * uy + y * ux
                    inner[2, lane] += x * uz + z * ux
                    inner[3, lane] += y * uy
                    inner[4, lane] += y * uz + z * uy
                    inner[5, lane] += z * uz
            for lane in range(_LANES):
                # Equal tilts make the 3 x 3 matrix singular: then depth explains nothing, which a ridge expresses.
                ridge = _RIDGE * (gram[0, lane] + gram[3, lane] + gram[5, lane])
                a00, a01, a02 = gram[0, lane] + ridge, gram[1, lane], gram[2, lane]
                a11, a12, a22 = gram[3, lane] + ridge, gram[4, lane], gram[5, lane] + ridge
                c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
                c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
                determinant = a00 * c00 + a01 * c01 + a02 * c02
                diagonal = c00 * inner[0, lane] + c11 * inner[3, lane] + c22 * inner[5, lane]
                beside = c01 * inner[1, lane] + c02 * inner[2, lane] + c12 * inner[4, lane]
                total[lane] += trace - 2 * (diagonal + beside) / determinant
        for lane in range(lanes):
            cost[first + lane] = total[lane]
