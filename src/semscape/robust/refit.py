"""Least-squares models of many matches (n, 4), in coordinates that are centred and of about unit size."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from semscape.robust.affine_epipolar import affine_matrix, fit_hyperplane, fit_hyperplane_bounded
from semscape.types import FloatArray

_LEAST_SPREAD = 1e-9
_GAUSS_NEWTON_STEPS = 5
_DIFFERENCE = 1e-7


def fit_affine(w: FloatArray) -> FloatArray | None:
    """Return the affine fundamental matrix of least squared distances in the 4-space of matches."""
    return affine_matrix(fit_hyperplane(w)) if len(w) > 4 else None


def fit_affine_bounded(w: FloatArray) -> FloatArray | None:
    """Return the affine fundamental matrix in which no match weighs more than others by its parallax."""
    return affine_matrix(fit_hyperplane_bounded(w)) if len(w) > 4 else None


def fit_fundamental(w: FloatArray) -> FloatArray | None:
    """Return the fundamental matrix of the normalized eight-point method (Hartley 1997, doi:10.1109/34.601246)."""
    normalizers = _normalizers(w)
    if len(w) < 9 or normalizers is None:
        return None
    one, two = (_homogeneous(xy) @ t.T for xy, t in zip((w[:, :2], w[:, 2:]), normalizers, strict=True))
    rows = (two[:, :, None] * one[:, None, :]).reshape(-1, 9)
    matrix = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    left, values, right = np.linalg.svd(matrix)
    rank_two = left[:, :2] * values[:2] @ right[:2]
    return np.asarray(normalizers[1].T @ rank_two @ normalizers[0])


def fit_essential(w: FloatArray) -> FloatArray | None:
    """Return the essential matrix of calibrated matches of least squared first-order distances (Sampson's).

    Gauss-Newton over the two rotations of its singular vectors, from what is next to the eight-point method's.
    """
    start = fit_fundamental(w)
    if start is None:
        return None
    left, _, right = np.linalg.svd(start)
    one, two = _homogeneous(w[:, :2]), _homogeneous(w[:, 2:])
    residual = _sampson_distances(left, right, one, two)
    for _ in range(_GAUSS_NEWTON_STEPS):
        steps = np.eye(6) * _DIFFERENCE
        moved = [_sampson_distances(*_turned(left, right, step), one, two) for step in steps]
        jacobian = (np.stack(moved, axis=1) - residual[:, None]) / _DIFFERENCE
        # One turn of both about the null direction changes nothing: the shortest step leaves it out.
        step: FloatArray = np.linalg.lstsq(jacobian, -residual, rcond=1e-6)[0].astype(np.float64)
        new_left, new_right = _turned(left, right, step)
        new_residual = _sampson_distances(new_left, new_right, one, two)
        if not new_residual @ new_residual < residual @ residual:
            break
        left, right, residual = new_left, new_right, new_residual
    return np.asarray(left[:, :2] @ right[:2])


def _turned(left: FloatArray, right: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    turns = Rotation.from_rotvec(step.reshape(2, 3)).as_matrix()
    return left @ turns[0], turns[1] @ right


def _sampson_distances(left: FloatArray, right: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Return signed distances (n,): Hartley & Zisserman 2004, section 11.4.3."""
    matrix = left[:, :2] @ right[:2]
    lines2, lines1 = one @ matrix.T, two @ matrix
    gradient = np.sqrt((lines2[:, :2] ** 2).sum(axis=1) + (lines1[:, :2] ** 2).sum(axis=1))
    return np.asarray((two * lines2).sum(axis=1) / np.maximum(gradient, 1e-12))


def fit_homography(w: FloatArray) -> FloatArray | None:
    """Return the homography of the normalized direct linear method (Hartley & Zisserman 2004, section 4.4)."""
    normalizers = _normalizers(w)
    if len(w) < 5 or normalizers is None:
        return None
    one, two = (_homogeneous(xy) @ t.T for xy, t in zip((w[:, :2], w[:, 2:]), normalizers, strict=True))
    zero = np.zeros_like(one)
    rows = np.vstack([np.hstack([one, zero, -two[:, :1] * one]), np.hstack([zero, one, -two[:, 1:2] * one])])
    matrix = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    return np.asarray(np.linalg.solve(normalizers[1], matrix @ normalizers[0]))


def _homogeneous(xy: FloatArray) -> FloatArray:
    return np.column_stack([xy, np.ones(len(xy))])


def _normalizers(w: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the transforms that bring each image's points to mean 0 and root-mean-square distance sqrt(2)."""
    found = []
    for xy in (w[:, :2], w[:, 2:]):
        centre = xy.mean(axis=0)
        spread = np.sqrt(((xy - centre) ** 2).sum(axis=1).mean() / 2)
        if not spread > _LEAST_SPREAD:
            return None
        found.append(np.array([[1 / spread, 0, -centre[0] / spread], [0, 1 / spread, -centre[1] / spread], [0, 0, 1]]))
    return found[0], found[1]
