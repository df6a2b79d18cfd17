"""The epipolar geometry of two parallel projections: a x1 + b y1 + c x2 + d y2 + e = 0.

A match is a point w = (x1, y1, x2, y2) of a 4-space, and all matches of a rigid scene lie in one
hyperplane n.w + e = 0 (Koenderink & van Doorn 1991, doi:10.1364/JOSAA.8.000377; Shapiro et al. 1995,
doi:10.1007/BF01539553). Four matches fix it.
"""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray

_TRIMMINGS = 5
_REWEIGHTINGS = 4
# In units of the images' size, far below a hundredth of a pixel: where a plane without noise has no parallax at all.
_LEAST_PARALLAX = 1e-7


def fit_hyperplane(w: FloatArray) -> FloatArray:
    """Return the total-least-squares hyperplane (5,) of matches w (M, 4), its normal of unit length."""
    n = len(w)
    centre = np.ones(n) @ w / n  # as a product: ten times faster than a sum over the long axis of a thin array
    _, vectors = np.linalg.eigh(w.T @ w - n * np.outer(centre, centre))
    normal = vectors[:, 0]
    return np.append(normal, -normal @ centre)


def fit_hyperplane_bounded(w: FloatArray) -> FloatArray:
    """Return the hyperplane (5,) of matches w (M, 4) with a bound on the influence that each has by its parallax.

    The direction of the lines is read from the parallax: a match that moves a hundred times as far along its line
    as the usual one weighs ten thousand times as much in it. Right matches move about alike; a wrong one that lies
    near its line by chance moves anywhere, so a few of them decide the direction and gather others of their kind.
    Here matches farther out along the third axis of the scatter than 1.5 times the median are weighted with the
    inverse square of it, so that none counts more than a usual one (Mallows' estimators: Hampel et al. 1986,
    doi:10.1002/9781118186435, chapter 6).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, y, parallax = rng.uniform(-0.5, 0.5, (3, 200)) * [[1], [1], [0.01]]
    >>> w = np.column_stack([x, y, x + parallax, y + rng.normal(0, 0.001, 200)])
    >>> w[:5, 2:] = np.column_stack([x[:5] + 0.4, y[:5] + 0.02])  # five wrong matches of one mind
    >>> fits = fit_hyperplane(w), fit_hyperplane_bounded(w)  # the wrong ones bend the first to themselves
    >>> [bool(epipolar_distance_px(fit, w[:5]).mean() > 0.01) for fit in fits]
    [False, True]
    """
    weight = np.ones(len(w))
    for _ in range(_REWEIGHTINGS):
        total = weight.sum()
        centre = weight @ w / total
        _, vectors = np.linalg.eigh((w.T * weight) @ w - total * np.outer(centre, centre))
        parallax = np.abs(w @ vectors[:, 1] - centre @ vectors[:, 1])
        reach = max(1.5 * float(np.median(parallax)), _LEAST_PARALLAX)
        weight = (reach / np.maximum(parallax, reach)) ** 2
    normal = vectors[:, 0]
    return np.append(normal, -normal @ centre)


def epipolar_distance_px(hyperplane: FloatArray, w: FloatArray) -> FloatArray:
    """Return the larger of each match's two distances to its epipolar lines (M,), in px."""
    weaker = min(np.hypot(hyperplane[0], hyperplane[1]), np.hypot(hyperplane[2], hyperplane[3]))
    distance: FloatArray = np.abs(w @ hyperplane[:4] + hyperplane[4]) / max(weaker, 1e-12)
    return distance


def affine_matrix(hyperplane: FloatArray) -> FloatArray:
    """Return F (3, 3) with x2^T F x1 = 0, of Frobenius norm 1.

    Examples
    --------
    >>> F = affine_matrix(np.array([0.0, 1.0, 0.0, -1.0, 0.0]))  # rows are epipolar lines: y1 = y2
    >>> float(np.array([7.0, 3.0, 1.0]) @ F @ np.array([2.0, 3.0, 1.0]))
    0.0
    """
    a, b, c, d, e = hyperplane
    matrix = np.array([[0.0, 0.0, c], [0.0, 0.0, d], [a, b, e]])
    normalized: FloatArray = matrix / np.linalg.norm(matrix)
    return normalized


def is_planar(w: FloatArray) -> bool:
    """Tell whether matches (n, 4) show no parallax: one affine map takes all points to their matches.

    Matches of a relief fill three dimensions of their 4-space and noise the fourth. Those of a plane fill two, and
    then no epipolar geometry is better than another: the third spread is noise too, less than twice the fourth.
    A tenth of the matches, wrong ones that lie near their epipolar line by chance, may stand out.

    Examples
    --------
    >>> x, y = np.divmod(np.arange(64.0), 8)
    >>> relief, noise = (x * y) % 7, (x * y) % 3 / 50
    >>> is_planar(np.column_stack([x, y, x + noise, y + (x + y) % 4 / 60]))
    True
    >>> is_planar(np.column_stack([x, y, x + relief, y + noise]))
    False
    """
    kept = np.ones(len(w), dtype=bool)
    for _ in range(_TRIMMINGS):
        centre = w[kept].mean(axis=0)
        deviation = w[kept] - centre
        across = (w - centre) @ np.linalg.eigh(deviation.T @ deviation)[1][:, :2]
        distance = np.hypot(across[:, 0], across[:, 1])
        kept = distance <= 4 * np.median(distance)
    noise, parallax = np.median(np.abs(across[kept]), axis=0)
    return bool(kept.mean() > 0.9 and parallax <= 2 * noise + 1e-6)


@njit(cache=True, nogil=True)
def hyperplane_of_four(w: FloatArray, i0: int, i1: int, i2: int, i3: int, out: FloatArray) -> bool:
    """Write the hyperplane through four matches to `out` (5,); False when they are degenerate."""
    a0, a1, a2, a3 = w[i1, 0] - w[i0, 0], w[i1, 1] - w[i0, 1], w[i1, 2] - w[i0, 2], w[i1, 3] - w[i0, 3]
    b0, b1, b2, b3 = w[i2, 0] - w[i0, 0], w[i2, 1] - w[i0, 1], w[i2, 2] - w[i0, 2], w[i2, 3] - w[i0, 3]
    c0, c1, c2, c3 = w[i3, 0] - w[i0, 0], w[i3, 1] - w[i0, 1], w[i3, 2] - w[i0, 2], w[i3, 3] - w[i0, 3]
    # The generalized cross product of three 4-vectors, by cofactors over the 2 x 2 minors of b and c.
    m01, m02, m03 = b0 * c1 - b1 * c0, b0 * c2 - b2 * c0, b0 * c3 - b3 * c0
    m12, m13, m23 = b1 * c2 - b2 * c1, b1 * c3 - b3 * c1, b2 * c3 - b3 * c2
    n0 = a1 * m23 - a2 * m13 + a3 * m12
    n1 = -(a0 * m23 - a2 * m03 + a3 * m02)
    n2 = a0 * m13 - a1 * m03 + a3 * m01
    n3 = -(a0 * m12 - a1 * m02 + a2 * m01)
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + n3 * n3)
    if length < 1e-9:
        return False
    n0, n1, n2, n3 = n0 / length, n1 / length, n2 / length, n3 / length
    if min(n0 * n0 + n1 * n1, n2 * n2 + n3 * n3) < 1e-4:  # lines only in one image: not two views of a scene
        return False
    out[0], out[1], out[2], out[3] = n0, n1, n2, n3
    out[4] = -(n0 * w[i0, 0] + n1 * w[i0, 1] + n2 * w[i0, 2] + n3 * w[i0, 3])
    return True
