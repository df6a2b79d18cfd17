"""The compiled heart of bundle adjustment: eliminate the points, keep the cameras."""

from __future__ import annotations

import numpy as np
from numba import njit

from semscape.types import FloatArray, IntArray

# The axis, which all views share, then tilt, roll, relative scale, anisotropy, x and y translation.
KERNEL_PARAMETERS = 7


@njit(cache=True, nogil=True)
def _symmetric_inverse(m: FloatArray) -> FloatArray:
    inverse = np.empty((3, 3))
    inverse[0, 0] = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    inverse[0, 1] = inverse[1, 0] = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    inverse[0, 2] = inverse[2, 0] = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    inverse[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    inverse[1, 2] = inverse[2, 1] = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    inverse[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    determinant = m[0, 0] * inverse[0, 0] + m[0, 1] * inverse[0, 1] + m[0, 2] * inverse[0, 2]
    scaled: FloatArray = inverse / determinant
    return scaled


@njit(cache=True, nogil=True)
def accumulate_schur(
    start: IntArray,
    view: IntArray,
    xy: FloatArray,
    weights: FloatArray,
    matrices: FloatArray,
    derivatives: FloatArray,
    translations: FloatArray,
    blocks: FloatArray,
    gradients: FloatArray,
    points: FloatArray,
) -> float:
    """Solve every point and add its Schur complement to the cameras' normal equations.

    Parameters
    ----------
    start : (P + 1,) int array
        First observation of each point, and K.
    view, xy, weights : (K,), (K, 2) and (K,) arrays
        The observations, in px, with their information in px^-2.
    matrices, derivatives, translations : (V, 2, 3), (V, 5, 2, 3) and (V, 2) float arrays
        Cameras, and d matrix / d (axis, tilt, roll, scale, anisotropy).
    blocks, gradients : (V, V, 7, 7) and (V, 7) float arrays
        Added to, in place.
    points : (P, 3) float array
        Written: every point at its best.

    Returns
    -------
    float
        The weighted squared residuals.
    """
    most = 0
    for point in range(len(start) - 1):
        most = max(most, start[point + 1] - start[point])
    jacobian = np.empty((most, 2, 7))
    coupling = np.empty((most, 7, 3))
    solved = np.empty((most, 3, 7))
    residual = np.empty((most, 2))
    cost = 0.0
    for point in range(len(start) - 1):
        first, count = start[point], start[point + 1] - start[point]
        normal = np.zeros((3, 3))
        right = np.zeros(3)
        for o in range(count):
            k = first + o
            camera = matrices[view[k]]
            for a in range(2):
                target = xy[k, a] - translations[view[k], a]
                for i in range(3):
                    right[i] += weights[k] * camera[a, i] * target
                    for j in range(3):
                        normal[i, j] += weights[k] * camera[a, i] * camera[a, j]
        inverse = _symmetric_inverse(normal)
        x = inverse @ right
        points[point] = x
        for o in range(count):
            k = first + o
            v = view[k]
            for a in range(2):
                predicted = translations[v, a]
                for i in range(3):
                    predicted += matrices[v, a, i] * x[i]
                residual[o, a] = xy[k, a] - predicted
                cost += weights[k] * residual[o, a] ** 2
                for p in range(5):
                    total = 0.0
                    for i in range(3):
                        total += derivatives[v, p, a, i] * x[i]
                    jacobian[o, a, p] = total
                jacobian[o, a, 5] = 1.0 - a
                jacobian[o, a, 6] = float(a)
            for p in range(7):
                gradients[v, p] += weights[k] * (
                    jacobian[o, 0, p] * residual[o, 0] + jacobian[o, 1, p] * residual[o, 1]
                )
                for i in range(3):
                    coupling[o, p, i] = weights[k] * (
                        jacobian[o, 0, p] * matrices[v, 0, i] + jacobian[o, 1, p] * matrices[v, 1, i]
                    )
                for q in range(7):
                    blocks[v, v, p, q] += weights[k] * (
                        jacobian[o, 0, p] * jacobian[o, 0, q] + jacobian[o, 1, p] * jacobian[o, 1, q]
                    )
            for i in range(3):
                for p in range(7):
                    total = 0.0
                    for j in range(3):
                        total += inverse[i, j] * coupling[o, p, j]
                    solved[o, i, p] = total
        for o1 in range(count):
            for o2 in range(count):
                v1, v2 = view[first + o1], view[first + o2]
                for p in range(7):
                    for q in range(7):
                        total = 0.0
                        for i in range(3):
                            total += coupling[o1, p, i] * solved[o2, i, q]
                        blocks[v1, v2, p, q] -= total
    return cost
