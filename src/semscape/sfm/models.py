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
UNDETERMINED = "the tracks do not determine the motion of the series: more matches or a wider tilt range are needed"


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

    def covariance(self, hessian: FloatArray) -> FloatArray:
        """Return the covariance of the parameters for the normal matrix at the bottom.

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

    def covariance(self, hessian: FloatArray) -> FloatArray:
        """Return the inverse of the normal matrix, with the error of a larger anisotropy added.

        That is one `anisotropy_reach` times as large as the estimate takes it to be:
        H^-1 (H + (reach^2 - 1) / sigma^2 on the anisotropies) H^-1.
        """
        inverse = inverted(hessian)
        by_anisotropy = inverse[:, 4::PARAMETERS_PER_VIEW]
        excess = (self._prior.anisotropy_reach**2 - 1) / self._prior.anisotropy_sigma**2
        covariance: FloatArray = inverse + excess * by_anisotropy @ by_anisotropy.T
        return covariance


def inverted(hessian: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix.

    Raises
    ------
    DegenerateGeometryError
        When it is singular.
    """
    try:
        return np.asarray(np.linalg.inv(hessian), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometryError(UNDETERMINED) from error


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
