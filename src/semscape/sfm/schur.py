"""The compiled heart of bundle adjustment: eliminate the points, keep the moments that the cameras need.

A coordinate's derivative by a camera's parameter is linear in the point, whatever the parameter. So sums over all
points of products of point coordinates, taken once, hold all that the normal equations of the cameras can ask for,
and the loop over the points knows nothing of parameters.
"""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray, IntArray

# x x^T of the point (x, y, z, 1), and the inverse of its 3 x 3 normal matrix, by their upper triangles.
_POINT_ROWS, _POINT_COLUMNS = np.triu_indices(4)
_INVERSE_ROWS, _INVERSE_COLUMNS = np.triu_indices(3)
_PRODUCTS = 60


def camera_equations(
    start: IntArray,
    view: IntArray,
    xy: FloatArray,
    weights: FloatArray,
    matrices: FloatArray,
    derivatives: FloatArray,
    translations: FloatArray,
) -> tuple[FloatArray, FloatArray, float]:
    """Solve every point and return the cameras' normal equations after the points are eliminated.

    Parameters
    ----------
    start : (P + 1,) int array
        First observation of each point, and K.
    view, xy, weights : (K,), (K, 2) and (K,) arrays
        The observations, in px, with their information in px^-2.
    matrices, derivatives, translations : (V, 2, 3), (V, L, 2, 3) and (V, 2) float arrays
        Cameras, and d matrix / d (their L parameters).

    Returns
    -------
    blocks, gradient : (V, L + 2, V, L + 2) and (V, L + 2) float arrays
        For the L parameters and the two of the translation of each view.
    cost : float
        The weighted squared residuals.
    """
    n_views, n_matrix = derivatives.shape[:2]
    pair_moments = np.zeros((n_views, n_views, _PRODUCTS))
    view_moments = np.zeros((n_views, 10))
    residual_moments = np.zeros((n_views, 2, 4))
    cost = _accumulate_moments(
        start, view, xy, weights, matrices, translations, pair_moments, view_moments, residual_moments
    )
    # d coordinate a / d parameter p = slope[p, a] . (x, y, z, 1)
    slope = np.zeros((n_views, n_matrix + 2, 2, 4))
    slope[:, :n_matrix, :, :3] = derivatives
    slope[:, n_matrix, 0, 3] = slope[:, n_matrix + 1, 1, 3] = 1.0

    product = np.empty((n_views, n_views, 10, 3, 3))
    product[..., _INVERSE_ROWS, _INVERSE_COLUMNS] = pair_moments.reshape(n_views, n_views, 10, 6)
    product[..., _INVERSE_COLUMNS, _INVERSE_ROWS] = product[..., _INVERSE_ROWS, _INVERSE_COLUMNS]
    full = np.empty((n_views, n_views, 3, 4, 3, 4))
    moved = np.moveaxis(product, 2, -1)
    full[:, :, :, _POINT_ROWS, :, _POINT_COLUMNS] = np.moveaxis(moved, -1, 0)
    full[:, :, :, _POINT_COLUMNS, :, _POINT_ROWS] = np.moveaxis(moved, -1, 0)
    coupling = np.einsum("vpaj,vai->vpij", slope, matrices).reshape(n_views, n_matrix + 2, 12)
    inner = full.reshape(n_views, n_views, 12, 12) @ np.swapaxes(coupling, 1, 2)[None]
    blocks = -np.swapaxes(coupling[:, None] @ inner, 1, 2)

    own = np.empty((n_views, 4, 4))
    own[:, _POINT_ROWS, _POINT_COLUMNS] = own[:, _POINT_COLUMNS, _POINT_ROWS] = view_moments
    each = np.arange(n_views)
    blocks[each, :, each, :] += np.einsum("vpaj,vjk,vqak->vpq", slope, own, slope, optimize=True)
    gradient = np.einsum("vpaj,vaj->vp", slope, residual_moments)
    return blocks, gradient, float(cost)


@njit(cache=True, nogil=True)
def _accumulate_moments(
    start: IntArray,
    view: IntArray,
    xy: FloatArray,
    weights: FloatArray,
    matrices: FloatArray,
    translations: FloatArray,
    pair_moments: FloatArray,
    view_moments: FloatArray,
    residual_moments: FloatArray,
) -> float:
    products = np.empty(_PRODUCTS)
    inverse = np.empty(6)
    x = np.ones(4)
    cost = 0.0
    for point in range(len(start) - 1):
        first, last = start[point], start[point + 1]
        _solve_point(first, last, view, xy, weights, matrices, translations, inverse, x)
        index = 0
        for j in range(4):
            for k in range(j, 4):
                for i in range(6):
                    products[6 * index + i] = x[j] * x[k] * inverse[i]
                index += 1
        for k1 in range(first, last):
            v1, w1 = view[k1], weights[k1]
            if w1 == 0.0:
                continue
            index = 0
            for j in range(4):
                for k in range(j, 4):
                    view_moments[v1, index] += w1 * x[j] * x[k]
                    index += 1
            for a in range(2):
                residual = xy[k1, a] - translations[v1, a]
                for i in range(3):
                    residual -= matrices[v1, a, i] * x[i]
                cost += w1 * residual * residual
                for j in range(4):
                    residual_moments[v1, a, j] += w1 * residual * x[j]
            # Views ascend within a point, so this fills the upper half.
            for k2 in range(k1, last):
                weight = w1 * weights[k2]
                target = pair_moments[v1, view[k2]]
                for i in range(_PRODUCTS):
                    target[i] += weight * products[i]
    for v1 in range(len(matrices)):
        for v2 in range(v1):
            pair_moments[v1, v2] = pair_moments[v2, v1]
    return cost


@njit(cache=True, nogil=True)
def solve_points(
    start: IntArray,
    view: IntArray,
    xy: FloatArray,
    weights: FloatArray,
    matrices: FloatArray,
    translations: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return every point at its best (P, 3), its covariance (P, 3, 3) for given cameras, and the residuals (K, 2).

    The arguments are those of `camera_equations`. A point that its views do not determine is not finite.
    """
    points = np.empty((len(start) - 1, 3))
    covariance = np.empty((len(start) - 1, 3, 3))
    residual = np.empty((len(view), 2))
    inverse = np.empty(6)
    x = np.ones(4)
    for point in range(len(start) - 1):
        first, last = start[point], start[point + 1]
        _solve_point(first, last, view, xy, weights, matrices, translations, inverse, x)
        points[point] = x[:3]
        index = 0
        for i in range(3):
            for j in range(i, 3):
                covariance[point, i, j] = covariance[point, j, i] = inverse[index]
                index += 1
        for k in range(first, last):
            for a in range(2):
                camera = matrices[view[k], a]
                predicted = camera[0] * x[0] + camera[1] * x[1] + camera[2] * x[2] + translations[view[k], a]
                residual[k, a] = xy[k, a] - predicted
    return points, covariance, residual


@njit(cache=True, nogil=True)
def cauchy_weights(
    start: IntArray,
    view: IntArray,
    xy: FloatArray,
    matrices: FloatArray,
    translations: FloatArray,
    width_px: float,
    rounds: int,
) -> FloatArray:
    """Return Cauchy weights (K,), each point reweighted on its own from equal weights.

    They depend on the cameras and the width alone, not on weights of earlier rounds: which of a point's views is the
    wrong one is decided anew each time, and the cameras come to one rest from any start.
    """
    weights = np.ones(len(view))
    inverse = np.empty(6)
    x = np.ones(4)
    for point in range(len(start) - 1):
        first, last = start[point], start[point + 1]
        for _ in range(rounds):
            _solve_point(first, last, view, xy, weights, matrices, translations, inverse, x)
            for k in range(first, last):
                squared = 0.0
                for a in range(2):
                    camera = matrices[view[k], a]
                    predicted = camera[0] * x[0] + camera[1] * x[1] + camera[2] * x[2] + translations[view[k], a]
                    squared += (xy[k, a] - predicted) ** 2
                weights[k] = 1 / (1 + squared / width_px**2)
    return weights


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_point(
    first: int,
    last: int,
    view: IntArray,
    xy: FloatArray,
    weights: FloatArray,
    matrices: FloatArray,
    translations: FloatArray,
    inverse: FloatArray,
    x: FloatArray,
) -> None:
    """Write the inverse of a point's normal matrix (upper triangle) and the point."""
    n00 = n01 = n02 = n11 = n12 = n22 = b0 = b1 = b2 = 0.0
    for k in range(first, last):
        v, w = view[k], weights[k]
        for a in range(2):
            m0, m1, m2 = matrices[v, a, 0], matrices[v, a, 1], matrices[v, a, 2]
            target = w * (xy[k, a] - translations[v, a])
            n00 += w * m0 * m0
            n01 += w * m0 * m1
            n02 += w * m0 * m2
            n11 += w * m1 * m1
            n12 += w * m1 * m2
            n22 += w * m2 * m2
            b0 += m0 * target
            b1 += m1 * target
            b2 += m2 * target
    c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    determinant = n00 * c00 + n01 * c01 + n02 * c02
    inverse[0], inverse[1], inverse[2] = c00 / determinant, c01 / determinant, c02 / determinant
    inverse[3] = (n00 * n22 - n02 * n02) / determinant
    inverse[4] = (n01 * n02 - n00 * n12) / determinant
    inverse[5] = (n00 * n11 - n01 * n01) / determinant
    x[0] = inverse[0] * b0 + inverse[1] * b1 + inverse[2] * b2
    x[1] = inverse[1] * b0 + inverse[3] * b1 + inverse[4] * b2
    x[2] = inverse[2] * b0 + inverse[4] * b1 + inverse[5] * b2
