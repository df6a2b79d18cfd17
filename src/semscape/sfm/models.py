"""Parametrizations of a series' motion: what bundle adjustment needs to know of its parameters."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from semscape.errors import DegenerateGeometryError
from semscape.geometry.rotations import CAM_FROM_WORLD_AT_ZERO_TILT, axis_rotation, roll_rotation
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, IntArray

PARAMETERS_PER_VIEW = 6  # tilt, roll, relative scale, anisotropy, x and y translation
TRANSLATION_SIGMA_PX = 100.0
UNDETERMINED = (
    "the tracks do not determine the motion of the series: more matches or a wider tilt range are needed, and tilts "
    "and pixel sizes that are those of these images"
)


class MotionModel(Protocol):
    """The parameters of all views in one vector, some of which views may share.

    `index` (V, L + 2) says where a view's L matrix parameters and its translation stand in the vector;
    `prior_index`, `prior_centre` and `prior_weight` (1 / sigma, 0 where free) are its normal priors.
    """

    index: IntArray
    prior_index: IntArray
    prior_centre: FloatArray
    prior_weight: FloatArray

    def cameras(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return camera matrices (V, 2, 3), d matrix / d (L parameters) (V, L, 2, 3) and translations (V, 2)."""
        ...

    def covariance(self, hessian: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the covariance of the parameters for the normal matrix at the bottom, where they are.

        Raises
        ------
        DegenerateGeometryError
            When the normal matrix is singular.
        """
        ...


class TiltSeriesModel:
    """A single-axis series: the axis, then per view tilt, roll, relative scale, anisotropy, x and y translation."""

    def __init__(self, prior: MotionPrior) -> None:
        views = prior.n_views
        self._prior = prior
        centre, sigma = prior.centre_and_sigma()
        per_view = np.arange(views)[:, None] * PARAMETERS_PER_VIEW + 1 + np.arange(PARAMETERS_PER_VIEW)
        self.index = np.column_stack([np.zeros(views, dtype=np.int64), per_view])
        self.prior_index = np.concatenate([[0], per_view[:, :4].ravel()])
        self.prior_centre = centre
        self.prior_weight = np.where(np.isfinite(sigma), 1 / sigma, 0.0)

    def cameras(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return camera matrices, their derivatives and translations, see `camera_jacobians`."""
        return camera_jacobians(parameters, self._prior.scale_px_per_um)

    def covariance(self, hessian: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the inverse of the normal matrix, averaged over what the anisotropy's sigma may be.

        Where sigmas and weights were learnt, it is the second moment of the mixture of all about `parameters`.
        """
        prior = self._prior
        if not len(prior.anisotropy_sigmas):
            return inverted(hessian)
        shift, covariance, _ = by_anisotropy_sigma(
            hessian, parameters[4::PARAMETERS_PER_VIEW], prior.anisotropy_sigma, prior.anisotropy_sigmas
        )
        mixed: FloatArray = np.tensordot(prior.anisotropy_weights, covariance, 1)
        mixed += (shift * prior.anisotropy_weights[:, None]).T @ shift
        return mixed


def by_anisotropy_sigma(
    hessian: FloatArray, anisotropy: FloatArray, sigma: float, others: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how parameters, covariance and evidence change where the anisotropy has another sigma.

    At the bottom the cost is a parabola, so nothing need be adjusted again.

    Parameters
    ----------
    hessian : (N, N) float array
        At the bottom for `sigma`, N = 1 + 6 V.
    anisotropy : (V,) float array
        At that bottom.
    sigma : float
    others : (S,) float array

    Returns
    -------
    shift, covariance, log_evidence : (S, N), (S, N, N) and (S,) float arrays
        Steps to the other bottoms, the inverse normal matrices there, and the logarithms of the probability of the data
        with all parameters integrated out, up to a constant.

    Raises
    ------
    DegenerateGeometryError
        When a normal matrix is singular.
    """
    at = np.arange(4, len(hessian), PARAMETERS_PER_VIEW)
    change = others**-2.0 - sigma**-2.0
    hessians = np.tile(hessian, (len(others), 1, 1))
    hessians[:, at, at] += change[:, None]
    covariance = inverted(hessians)
    shift = -change[:, None] * (covariance[:, :, at] @ anisotropy)
    moved = anisotropy + shift[:, at]
    cost = np.einsum("sk,kl,sl->s", shift, hessian, shift) + change * (moved**2).sum(axis=1)
    _, log_determinant = np.linalg.slogdet(hessians)
    return shift, covariance, -0.5 * (cost + log_determinant) - len(at) * np.log(others)


def inverted(hessian: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix, or of a stack of them.

    Raises
    ------
    DegenerateGeometryError
        When it is singular, or so nearly that rounding leaves negative variances.
    """
    try:
        covariance = np.asarray(np.linalg.inv(hessian), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometryError(UNDETERMINED) from error
    if not (np.diagonal(covariance, axis1=-2, axis2=-1) > 0).all():
        raise DegenerateGeometryError(UNDETERMINED)
    return covariance


def camera_jacobians(parameters: FloatArray, scale_px_per_um: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return camera matrices (V, 2, 3), d matrix / d (axis, tilt, roll, scale, anisotropy) and translations (V, 2)."""
    axis = parameters[0]
    per_view = parameters[1:].reshape(-1, PARAMETERS_PER_VIEW)
    tilt, roll, scale, anisotropy = per_view[:, 0], per_view[:, 1], per_view[:, 2], per_view[:, 3]
    tilted = CAM_FROM_WORLD_AT_ZERO_TILT @ axis_rotation(axis, tilt)
    # Rodrigues: dRot/dtilt = [a]x Rot; Rot(axis + d) = Rz(d) Rot Rz(-d), so dRot/daxis = [z]x Rot - Rot [z]x.
    across = cross_matrix(np.array([np.cos(axis), np.sin(axis), 0.0]))
    about_z = cross_matrix(np.array([0.0, 0.0, 1.0]))
    rotation = axis_rotation(axis, tilt)
    tilted_by_tilt = CAM_FROM_WORLD_AT_ZERO_TILT @ (across @ rotation)
    tilted_by_axis = CAM_FROM_WORLD_AT_ZERO_TILT @ (about_z @ rotation - rotation @ about_z)
    rolled = roll_rotation(roll)
    stretch = np.stack([1 + anisotropy / 2, 1 - anisotropy / 2], axis=-1)[:, :, None]
    size = (scale_px_per_um * (1 + scale))[:, None, None]

    def finish(rotated: FloatArray) -> FloatArray:
        projected: FloatArray = stretch * size * rotated[:, :2]
        return projected

    matrices = finish(rolled @ tilted)
    derivatives = np.stack(
        [
            finish(rolled @ tilted_by_axis),
            finish(rolled @ tilted_by_tilt),
            finish(about_z @ rolled @ tilted),
            matrices / (1 + scale)[:, None, None],
            np.array([0.5, -0.5])[:, None] * size * (rolled @ tilted)[:, :2],
        ],
        axis=1,
    )
    return matrices, derivatives, np.ascontiguousarray(per_view[:, 4:6])


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of the cross product with v."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
