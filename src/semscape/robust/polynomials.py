"""Small dense algebra for the minimal solvers, compiled: null spaces of nine unknowns, real roots."""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray

_SINGULAR = 1e-10
_ROOT_STEPS = 100
_COS, _SIN = 0.6, 0.8


@njit(cache=True, nogil=True)
def null_space(equations: FloatArray, basis: FloatArray) -> bool:
    """Write a basis (9 - m, 9) of the null space of m equations (m, 9), which are overwritten.

    Gauss-Jordan elimination with complete pivoting; False where the equations depend on each other.
    """
    m = equations.shape[0]
    order = np.arange(9)
    largest = np.abs(equations).max()
    for step in range(m):
        row, col, pivot = step, step, 0.0
        for i in range(step, m):
            for j in range(step, 9):
                if abs(equations[i, j]) > pivot:
                    row, col, pivot = i, j, abs(equations[i, j])
        if pivot <= _SINGULAR * largest:
            return False
        for j in range(9):
            equations[step, j], equations[row, j] = equations[row, j], equations[step, j]
        for i in range(m):
            equations[i, step], equations[i, col] = equations[i, col], equations[i, step]
        order[step], order[col] = order[col], order[step]
        inverse = 1.0 / equations[step, step]
        for j in range(step, 9):
            equations[step, j] *= inverse
        for i in range(m):
            if i != step:
                factor = equations[i, step]
                for j in range(step, 9):
                    equations[i, j] -= factor * equations[step, j]
    for free in range(9 - m):
        basis[free, :] = 0.0
        basis[free, order[m + free]] = 1.0
        for i in range(m):
            basis[free, order[i]] = -equations[i, m + free]
        basis[free] /= np.sqrt((basis[free] ** 2).sum())
    # Each vector but one is zero at a free unknown, and so is the last one's weight in a solution that is zero there,
    # as entries of affine matrices are. Mixing keeps solvers that set that weight to one from losing it.
    for free in range(8 - m):
        for j in range(9):
            a, b = basis[free, j], basis[free + 1, j]
            basis[free, j], basis[free + 1, j] = _COS * a - _SIN * b, _SIN * a + _COS * b
    return True


@njit(cache=True, nogil=True)
def real_roots(coefficients: FloatArray, roots: FloatArray) -> int:
    """Write the real roots of sum c_i x^i in rising order and return their number; a double root may be missed.

    Between two neighbouring roots of its derivative a polynomial is monotonic, so each such interval holds one
    root or none. Starting from the linear derivative the roots climb up to the polynomial itself.
    """
    degree = len(coefficients) - 1
    largest = np.abs(coefficients).max()
    while degree > 0 and abs(coefficients[degree]) <= 1e-14 * largest:
        degree -= 1
    if degree == 0:
        return 0
    bound = 0.0  # of all roots: Fujiwara 1916
    for i in range(degree):
        bound = max(bound, 2.0 * abs(coefficients[i] / coefficients[degree]) ** (1.0 / (degree - i)))
    derivatives = np.zeros((degree + 1, degree + 1))  # row d has degree d
    derivatives[degree] = coefficients[: degree + 1]
    for d in range(degree - 1, 0, -1):
        for i in range(d + 1):
            derivatives[d, i] = (i + 1) * derivatives[d + 1, i + 1]
    ends = np.empty(degree + 2)
    n = 0
    for d in range(1, degree + 1):
        ends[0] = -bound
        ends[1 : n + 1] = roots[:n]
        ends[n + 1] = bound
        n_intervals, n = n + 1, 0
        for i in range(n_intervals):
            low, high = ends[i], ends[i + 1]
            at_low, at_high = _value(derivatives[d], d, low), _value(derivatives[d], d, high)
            if (at_low <= 0.0) != (at_high <= 0.0):
                roots[n] = _root_between(derivatives[d], d, low, high, at_low > 0.0)
                n += 1
    return n


@njit(cache=True, nogil=True)
def _value(polynomial: FloatArray, degree: int, x: float) -> float:
    value: float = polynomial[degree]
    for i in range(degree - 1, -1, -1):
        value = value * x + polynomial[i]
    return value


@njit(cache=True, nogil=True)
def _root_between(polynomial: FloatArray, degree: int, low: float, high: float, falls: bool) -> float:
    """Newton's steps; halving the bracket where they leave it or do not halve their own length."""
    x = 0.5 * (low + high)
    last = high - low
    for _ in range(_ROOT_STEPS):
        value, slope = polynomial[degree], 0.0
        for i in range(degree - 1, -1, -1):
            slope = slope * x + value
            value = value * x + polynomial[i]
        if (value > 0.0) == falls:
            low = x
        else:
            high = x
        step = value / slope if slope != 0.0 else np.inf
        following = x - step
        if not (low < following < high and 2.0 * abs(step) < last):
            following = 0.5 * (low + high)
        last = abs(following - x)
        x = following
        if last <= 1e-15 * abs(x):
            break
    return x
