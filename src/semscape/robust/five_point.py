"""The essential matrix from five calibrated matches, by Nister's elimination.

References
----------
Nister 2004, "An efficient solution to the five-point relative pose problem", doi:10.1109/TPAMI.2004.17
"""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.robust.polynomials import null_space, real_roots
from semscape.types import FloatArray, IntArray

# Exponents of (x, y, z). E = x X + y Y + z Z + W has linear entries, its ten constraints are cubic; the order of the
# cubic monomials is Nister's: eliminating the first ten leaves polynomials in z times x, y and 1.
_LINEAR = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))
_QUADRATIC = (
    (2, 0, 0), (1, 1, 0), (1, 0, 1), (1, 0, 0), (0, 2, 0), (0, 1, 1), (0, 1, 0), (0, 0, 2), (0, 0, 1), (0, 0, 0),
)  # fmt: skip
_CUBIC = (
    (3, 0, 0), (0, 3, 0), (2, 1, 0), (1, 2, 0), (2, 0, 1), (2, 0, 0), (0, 2, 1), (0, 2, 0), (1, 1, 1), (1, 1, 0),
    (1, 0, 2), (1, 0, 1), (1, 0, 0), (0, 1, 2), (0, 1, 1), (0, 1, 0), (0, 0, 3), (0, 0, 2), (0, 0, 1), (0, 0, 0),
)  # fmt: skip


def _products(left: tuple[tuple[int, ...], ...], out: tuple[tuple[int, ...], ...]) -> IntArray:
    """Return where in `out` the product of each monomial of `left` with each linear one stands."""
    return np.array([[out.index(tuple(np.add(a, b).tolist())) for b in _LINEAR] for a in left])


_LINEAR_TIMES = _products(_LINEAR, _QUADRATIC)
_QUADRATIC_TIMES = _products(_QUADRATIC, _CUBIC)


@njit(cache=True, nogil=True)
def solve_essential(w: FloatArray, samples: IntArray, matrices: FloatArray, count: IntArray) -> None:
    """Write the up to ten essential matrices of each sample of five matches `w` (n, 4) in calibrated coordinates."""
    equations = np.empty((5, 9))
    basis = np.empty((4, 9))
    for trial in range(len(samples)):
        for i in range(5):
            x, y, u, v = w[samples[trial, i]]
            equations[i] = np.array([u * x, u * y, u, v * x, v * y, v, x, y, 1.0])
        count[trial] = _solve_in(basis, matrices[trial]) if null_space(equations, basis) else 0


@njit(cache=True, nogil=True)
def _solve_in(basis: FloatArray, matrices: FloatArray) -> int:
    """Write the essential matrices x X + y Y + z Z + W of a basis (4, 9)."""
    constraints = _constraints(np.ascontiguousarray(basis.T).reshape(3, 3, 4))
    if not _eliminate(constraints):
        return 0
    b = np.zeros((3, 3, 5))  # entries of Nister's B(z), rising powers
    for row in range(3):
        upper, lower = constraints[4 + 2 * row], constraints[5 + 2 * row]
        for column, (start, degree) in enumerate(((10, 2), (13, 2), (16, 3))):
            for i in range(degree + 1):
                b[row, column, degree - i] += upper[start + i]
                b[row, column, degree - i + 1] -= lower[start + i]
    roots = np.empty(11)
    n = 0
    for z in roots[: real_roots(_determinant(b), roots)]:
        at_z = np.zeros((3, 3))
        for power in range(4, -1, -1):
            at_z = at_z * z + b[:, :, power]
        x, y, scale = _null_vector(at_z)
        if abs(scale) > 0.0:
            essential = x / scale * basis[0] + y / scale * basis[1] + z * basis[2] + basis[3]
            matrices[n] = (essential / np.sqrt((essential**2).sum())).reshape(3, 3)
            n += 1
    return n


@njit(cache=True, nogil=True)
def _constraints(e: FloatArray) -> FloatArray:
    """Return (10, 20): (E E^T - tr(E E^T) / 2) E = 0 and det E = 0, for entries (3, 3, 4) linear in x, y, z."""
    gram = np.zeros((3, 3, 10))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                _add_linear(e[i, k], e[j, k], 1.0, gram[i, j])
    half_trace = 0.5 * (gram[0, 0] + gram[1, 1] + gram[2, 2])
    for i in range(3):
        gram[i, i] -= half_trace
    out = np.zeros((10, 20))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                _add_quadratic(gram[i, k], e[k, j], out[3 * i + j])
    for j in range(3):
        minor = np.zeros(10)
        after, last = (j + 1) % 3, (j + 2) % 3
        _add_linear(e[1, after], e[2, last], 1.0, minor)
        _add_linear(e[1, last], e[2, after], -1.0, minor)
        _add_quadratic(minor, e[0, j], out[9])
    return out


@njit(cache=True, nogil=True)
def _add_linear(left: FloatArray, right: FloatArray, sign: float, out: FloatArray) -> None:
    for i in range(4):
        for j in range(4):
            out[_LINEAR_TIMES[i, j]] += sign * left[i] * right[j]


@njit(cache=True, nogil=True)
def _add_quadratic(left: FloatArray, right: FloatArray, out: FloatArray) -> None:
    for i in range(10):
        for j in range(4):
            out[_QUADRATIC_TIMES[i, j]] += left[i] * right[j]


@njit(cache=True, nogil=True)
def _eliminate(rows: FloatArray) -> bool:
    """Gauss-Jordan over the first ten of twenty columns, with partial pivoting; False where singular."""
    largest = np.abs(rows).max()
    for step in range(10):
        pivot = step + np.abs(rows[step:, step]).argmax()
        if abs(rows[pivot, step]) <= 1e-13 * largest:
            return False
        for j in range(step, 20):
            rows[step, j], rows[pivot, j] = rows[pivot, j], rows[step, j]
        rows[step] /= rows[step, step]
        for i in range(10):
            if i != step:
                rows[i] -= rows[i, step] * rows[step]
    return True


@njit(cache=True, nogil=True)
def _determinant(b: FloatArray) -> FloatArray:
    """Return the determinant's coefficients (11,) of a 3 x 3 matrix of polynomials (3, 3, 5)."""
    out = np.zeros(11)
    for j in range(3):
        after, last = (j + 1) % 3, (j + 2) % 3
        minor = np.convolve(b[0, after], b[1, last]) - np.convolve(b[0, last], b[1, after])
        out += np.convolve(minor, b[2, j])[:11]
    return out


@njit(cache=True, nogil=True)
def _null_vector(m: FloatArray) -> FloatArray:
    """Return the longest cross product of two rows of a singular 3 x 3 matrix."""
    best = np.zeros(3)
    longest = -1.0
    for i in range(3):
        a, b = m[i], m[(i + 1) % 3]
        cross = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
        length = (cross**2).sum()
        if length > longest:
            longest = length
            best[:] = cross
    return best
