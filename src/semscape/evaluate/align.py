"""Lay a result over a truth: by a similarity, by a rigid motion, or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from semscape.evaluate.surface import Surface, closest
from semscape.types import FloatArray

AlignmentKind = Literal["none", "rigid", "similarity"]
ALIGNMENTS: tuple[AlignmentKind, ...] = ("none", "rigid", "similarity")

_CLIPPING_ROUNDS = 8
_MAX_ITERATIONS = 40
_TOLERANCE = 1e-5
# A similarity that leaves the scale where it began by more than this factor has found nothing: a result shrunk to a
# point of the surface has no distance from it.
_MOST_RESCALED = 2.0
# Tukey's usual constant: 95 % efficiency for normal errors.
_TUKEY = 4.685
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class Alignment:
    """The map x -> scale R x + t from a result's frame to the truth's; `translation_um` (3,), `rotation` (3, 3)."""

    scale: float
    rotation: FloatArray
    translation_um: FloatArray

    def apply(self, points_um: FloatArray) -> FloatArray:
        """Return points (N, 3) in the truth's frame."""
        moved: FloatArray = self.scale * points_um @ self.rotation.T + self.translation_um
        return moved

    def undo(self, points_um: FloatArray) -> FloatArray:
        """Return points (N, 3) of the truth's frame in the result's."""
        moved: FloatArray = (points_um - self.translation_um) @ self.rotation / self.scale
        return moved

    @property
    def angle_rad(self) -> float:
        """Angle of the rotation."""
        return float(Rotation.from_matrix(self.rotation).magnitude())


def identity() -> Alignment:
    """Return the alignment that changes nothing."""
    return Alignment(1.0, np.eye(3), np.zeros(3))


def align_points(found_um: FloatArray, truth_um: FloatArray, kind: AlignmentKind) -> Alignment:
    """Align points that are known to belong together, by least squares without outliers.

    Parameters
    ----------
    found_um, truth_um : (N, 3) float array
        Row n of both is the same point of the specimen.
    kind : "similarity", "rigid" or "none"

    Returns
    -------
    Alignment
        Fitted without the points that are farther off than 4 robust sigmas.

    References
    ----------
    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE TPAMI 13
    (1991), doi:10.1109/34.88573.

    Examples
    --------
    >>> cube = np.array([[i, j, k] for i in (0.0, 1) for j in (0.0, 1) for k in (0.0, 2)])
    >>> fitted = align_points(cube, 1.5 * cube + 7.0, "similarity")
    >>> round(fitted.scale, 9), fitted.translation_um.round(9).tolist()
    (1.5, [7.0, 7.0, 7.0])
    """
    if kind not in ALIGNMENTS:
        raise ValueError(f"the alignment must be one of {', '.join(ALIGNMENTS)}, got {kind!r}")
    if kind == "none":
        return identity()
    if len(found_um) < 3 or found_um.shape != truth_um.shape:
        raise ValueError(f"an alignment needs 3 or more pairs of points, got {found_um.shape} and {truth_um.shape}")
    kept = np.ones(len(found_um), dtype=np.bool_)
    for _ in range(_CLIPPING_ROUNDS):
        fitted = _umeyama(found_um[kept], truth_um[kept], with_scale=kind == "similarity")
        off = np.linalg.norm(fitted.apply(found_um) - truth_um, axis=1)
        now = off <= 4 * _MAD_TO_SIGMA * np.median(off) + 1e-12
        if (now == kept).all():
            break
        kept = now
    return fitted


def align_to_surface(
    points_um: FloatArray, truth: Surface, kind: AlignmentKind, start: Alignment | None = None
) -> Alignment:
    """Align points to a surface: iterated closest points, distances along the normals, outliers weighed down.

    Parameters
    ----------
    points_um : (N, 3) float array
        A few thousand points of the result.
    truth : Surface
    kind : "similarity", "rigid" or "none"
    start : Alignment, optional
        Where to begin; it must be so near that most closest points are about right.

    Returns
    -------
    Alignment
        What neither surface determines (a turn of a sphere, a shift along a plane) is left as at the start; so is all
        of a similarity that does not settle within a factor of two of the scale it began with.

    References
    ----------
    Y. Chen & G. Medioni, "Object modelling by registration of multiple range images", Image and Vision Computing 10
    (1992), doi:10.1016/0262-8856(92)90066-C.
    """
    begun = identity() if start is None else start
    current = begun
    if kind == "none":
        return current
    size = float(np.linalg.norm(points_um - points_um.mean(axis=0), axis=1).mean()) * current.scale
    for _ in range(_MAX_ITERATIONS):
        moved = current.apply(points_um)
        foot = closest(truth, moved)
        centre = moved.mean(axis=0)
        offset = np.einsum("ij,ij->i", moved - foot.points, foot.normals)
        sigma = _MAD_TO_SIGMA * float(np.median(np.abs(offset))) + 1e-9 * size
        weight = np.clip(1 - (offset / (_TUKEY * sigma)) ** 2, 0, None)  # the root of Tukey's weight
        arm = (moved - centre) / size
        columns = [np.cross(arm, foot.normals), foot.normals]
        if kind == "similarity":
            columns.append(np.einsum("ij,ij->i", arm, foot.normals)[:, None])
        design = np.hstack(columns) * weight[:, None]
        # The cut-off leaves directions that the surface does not determine unchanged.
        step, *_ = np.linalg.lstsq(design.T @ design, design.T @ (-offset * weight / size), rcond=1e-8)
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        scale = float(np.exp(step[6])) if kind == "similarity" else 1.0
        shift = centre + size * step[3:6] - scale * turn @ centre
        current = Alignment(
            current.scale * scale, turn @ current.rotation, scale * turn @ current.translation_um + shift
        )
        if abs(np.log(current.scale / begun.scale)) > np.log(_MOST_RESCALED):
            return begun
        if np.abs(step).max() < _TOLERANCE:
            break
    return current


def _umeyama(found: FloatArray, truth: FloatArray, *, with_scale: bool) -> Alignment:
    found_mean, truth_mean = found.mean(axis=0), truth.mean(axis=0)
    a, b = found - found_mean, truth - truth_mean
    u, singular, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])  # a mirror image is no alignment
    rotation = (u * sign) @ vt
    scale = float((singular * sign).sum() / (a**2).sum()) if with_scale else 1.0
    return Alignment(scale, rotation, truth_mean - scale * rotation @ found_mean)
