"""Minimal solvers: each turns many samples of matches into 3 x 3 matrices at once, compiled.

Points are centred and of about unit size. A solver writes `matrices` (B, S, 3, 3) and `count` (B,), the number of
solutions of each of B samples; degenerate samples have none.
"""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.robust.affine_epipolar import hyperplane_of_four
from semscape.robust.polynomials import null_space, real_roots
from semscape.types import FloatArray, IntArray

_LEAST_TRIANGLE = 1e-6


@njit(cache=True, nogil=True)
def solve_affine(w: FloatArray, samples: IntArray, matrices: FloatArray, count: IntArray) -> None:
    """Affine fundamental matrices from four matches each."""
    hyperplane = np.empty(5)
    for trial in range(len(samples)):
        i0, i1, i2, i3 = samples[trial]
        count[trial] = 0
        if hyperplane_of_four(w, i0, i1, i2, i3, hyperplane):
            count[trial] = 1
            matrix = matrices[trial, 0]
            matrix[:] = 0.0
            matrix[2, 0], matrix[2, 1], matrix[0, 2], matrix[1, 2], matrix[2, 2] = hyperplane


@njit(cache=True, nogil=True)
def solve_fundamental(w: FloatArray, samples: IntArray, matrices: FloatArray, count: IntArray) -> None:
    """Fundamental matrices from seven matches each: det(F1 + x F2) = 0 over the null space, 1 or 3 solutions."""
    equations = np.empty((7, 9))
    basis = np.empty((2, 9))
    coefficients, roots = np.empty(4), np.empty(4)
    for trial in range(len(samples)):
        for i in range(7):
            _epipolar_row(w[samples[trial, i]], equations[i])
        count[trial] = 0
        if not null_space(equations, basis):
            continue
        coefficients[0], coefficients[3] = _determinant(basis[0]), _determinant(basis[1])
        plus, minus = _determinant(basis[0] + basis[1]), _determinant(basis[0] - basis[1])
        coefficients[1] = 0.5 * (plus - minus) - coefficients[3]
        coefficients[2] = 0.5 * (plus + minus) - coefficients[0]
        n = real_roots(coefficients, roots)
        for s in range(n):
            matrices[trial, s] = (basis[0] + roots[s] * basis[1]).reshape(3, 3)
        count[trial] = n


@njit(cache=True, nogil=True)
def solve_homography(w: FloatArray, samples: IntArray, matrices: FloatArray, count: IntArray) -> None:
    """Homographies x2 = H x1 from four matches each; no three on a line, and none turned over."""
    equations = np.empty((8, 9))
    basis = np.empty((1, 9))
    for trial in range(len(samples)):
        sample = samples[trial]
        count[trial] = 0
        if not _same_side(w, sample):
            continue
        for i in range(4):
            x, y, u, v = w[sample[i]]
            equations[2 * i] = np.array([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u])
            equations[2 * i + 1] = np.array([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v])
        if null_space(equations, basis):
            matrices[trial, 0] = basis.reshape(3, 3)
            count[trial] = 1


@njit(cache=True, nogil=True)
def _epipolar_row(match: FloatArray, row: FloatArray) -> None:
    """Write the coefficients of F, row by row, in x2^T F x1 = 0."""
    x, y, u, v = match
    row[0], row[1], row[2] = u * x, u * y, u
    row[3], row[4], row[5] = v * x, v * y, v
    row[6], row[7], row[8] = x, y, 1.0


@njit(cache=True, nogil=True)
def _determinant(m: FloatArray) -> float:
    value: float = (
        m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6])
    )
    return value


@njit(cache=True, nogil=True)
def _same_side(w: FloatArray, sample: IntArray) -> bool:
    """Tell whether every three of four matches make triangles of one relative orientation in the two images.

    A camera sees a plane from one side, so the third coordinates of its points have one sign: Werner & Pajdla
    2001, doi:10.1109/ICCV.2001.937580.
    """
    sign = 0.0
    for left_out in range(4):
        a, b, c = w[sample[(left_out + 1) % 4]], w[sample[(left_out + 2) % 4]], w[sample[(left_out + 3) % 4]]
        area1 = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        area2 = (b[2] - a[2]) * (c[3] - a[3]) - (b[3] - a[3]) * (c[2] - a[2])
        if abs(area1) < _LEAST_TRIANGLE or abs(area2) < _LEAST_TRIANGLE or area1 * area2 * sign < 0.0:
            return False
        sign = area1 * area2
    return True
