"""Bundle adjustment of a single-axis tilt series: cameras and points, robust, with covariance.

The points are linear in the scaled orthographic camera, so they are solved for exactly at every step
(variable projection) and the Gauss-Newton step runs over the cameras alone, through the Schur complement.
This walks the bas-relief valley in a few steps, where alternating or first-order methods stop early.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.errors import DegenerateGeometryError
from semscape.sfm.models import (
    PARAMETERS_PER_VIEW,
    TRANSLATION_SIGMA_PX,
    UNDETERMINED,
    MotionModel,
    TiltSeriesModel,
)
from semscape.sfm.noise import noise_sigma_px
from semscape.sfm.priors import MotionPrior
from semscape.sfm.schur import camera_equations, cauchy_weights, solve_points
from semscape.types import FloatArray, Observations

_CAUCHY = 2.385
_RELATIVE_TOLERANCE = 1e-14
_REWEIGHTING_TOLERANCE = 1e-7
_STEPS_PER_REWEIGHTING = 3
_ROUNDS_PER_POINT = 8


@dataclass(frozen=True)
class Adjustment:
    """The bottom of the adjustment.

    `parameters` (1 + 6 V,): axis angle, then per view tilt, roll, relative scale, anisotropy, x and y translation;
    `covariance` their covariance; `points_um` (P, 3); `residual_px` (K, 2); `weights` (K,) the robust weights;
    `sigma_px` the noise of one coordinate; `cost` data plus prior terms.
    """

    parameters: FloatArray
    covariance: FloatArray
    points_um: FloatArray
    residual_px: FloatArray
    weights: FloatArray
    sigma_px: float
    cost: float
    n_iterations: int


def adjust(
    parameters: FloatArray,
    observations: Observations,
    prior: MotionPrior,
    *,
    max_iterations: int,
    overdispersion: float = 1.0,
) -> Adjustment:
    """Refine motion and points to the bottom of the robust, prior-weighted reprojection error.

    Parameters
    ----------
    parameters : (1 + 6 V,) float array
        Start, in the order of `Adjustment.parameters`.
    observations : Observations
        Sorted by point, at least two per point.
    prior : MotionPrior
        Sigmas in the parameters' units; they also fix the gauge.
    max_iterations : int
        Largest number of reweighting rounds.
    overdispersion : float
        Variance inflation of the data, from `noise.residual_overdispersion`; 1 for independent keypoints.

    Raises
    ------
    DegenerateGeometryError
        When the normal equations are singular: the tracks do not determine the motion.

    References
    ----------
    Triggs et al. 2000, doi:10.1007/3-540-44480-7_21 (bundle adjustment); Golub & Pereyra 1973,
    doi:10.1137/0710036 (variable projection).
    """
    return refine(
        parameters,
        observations,
        TiltSeriesModel(prior),
        max_iterations=max_iterations,
        overdispersion=overdispersion,
    )


def refine(
    parameters: FloatArray,
    observations: Observations,
    model: MotionModel,
    *,
    max_iterations: int,
    overdispersion: float = 1.0,
) -> Adjustment:
    """Refine motion and points under any model of the motion; the other arguments are those of `adjust`."""
    problem = Problem(observations, model)
    weights = np.ones(len(observations.view))
    iterations = 0
    for _ in range(max_iterations):
        sigma_px = noise_sigma_px(problem.residuals(parameters, weights), observations, weights)
        weights = problem.cauchy_weights(parameters, sigma_px)
        information = weights / (sigma_px**2 * overdispersion)
        start = parameters
        parameters, _, steps = problem.minimize(parameters, information, max_steps=_STEPS_PER_REWEIGHTING)
        iterations += steps
        if np.abs(problem.scaled(parameters - start)).max() < _REWEIGHTING_TOLERANCE:
            break
    parameters, cost, steps = problem.minimize(parameters, information, max_steps=200)
    hessian = problem.normal_equations(parameters, information).hessian
    covariance = model.covariance(hessian, parameters)
    points, _, residual = problem.triangulate(parameters, weights)
    return Adjustment(parameters, covariance, points, residual, weights, sigma_px, cost, iterations + steps)


def points_covariance(
    found: Adjustment, observations: Observations, model: MotionModel, overdispersion: float = 1.0
) -> FloatArray:
    """Return the covariances (P, 3, 3) um^2 of an adjustment's points: their own noise and that of all cameras.

    Parameters
    ----------
    found : Adjustment
        To the same observations, model and overdispersion.
    """
    problem = Problem(observations, model)
    information = found.weights / (found.sigma_px**2 * overdispersion)
    points, total, _ = problem.triangulate(found.parameters, information)
    spread, axes = np.linalg.eigh(found.covariance)
    for index in np.flatnonzero(spread > 1e-16 * spread[-1]):
        nudge = axes[:, index] * np.sqrt(spread[index])
        shift = problem.triangulate(found.parameters + nudge, information)[0] - points
        shift -= shift.mean(axis=0)  # a common shift is the choice of origin, not an error
        total += shift[:, :, None] * shift[:, None, :]
    return total


def with_translations(searched: FloatArray, observations: Observations, n_views: int) -> FloatArray:
    """Add to the searched motion (1 + 4 V,) the translations, from the mean of each view's observations."""
    parameters = np.empty(1 + PARAMETERS_PER_VIEW * n_views)
    parameters[0] = searched[0]
    for offset in range(1, 5):
        parameters[offset::PARAMETERS_PER_VIEW] = searched[offset::4]
    for axis in (0, 1):
        total = np.bincount(observations.view, observations.xy[:, axis], minlength=n_views)
        count = np.maximum(np.bincount(observations.view, minlength=n_views), 1)
        parameters[5 + axis :: PARAMETERS_PER_VIEW] = total / count
    return parameters


def robust_cost(
    parameters: FloatArray,
    observations: Observations,
    model: MotionModel,
    sigma_px: float,
    overdispersion: float = 1.0,
) -> float:
    """Return the Cauchy cost of the residuals plus the squared priors, to compare motions at one noise.

    It is twice a negative log-posterior. `Adjustment.cost`, whose noise follows the residuals, cannot tell a good
    fit from a bad one.
    """
    problem = Problem(observations, model)
    residual = problem.residuals(parameters, problem.cauchy_weights(parameters, sigma_px))
    width_px = _CAUCHY * sigma_px
    data = _CAUCHY**2 * float(np.log1p((residual**2).sum(axis=1) / width_px**2).sum()) / overdispersion
    deviation = problem.prior_deviation(parameters)
    return data + float(deviation @ deviation)


@dataclass(frozen=True)
class NormalEquations:
    """Half the cost's second and minus half its first derivative by all parameters, the points eliminated."""

    hessian: FloatArray
    gradient: FloatArray
    cost: float


class Problem:
    """The tracks and a model of the motion, ready for evaluation."""

    def __init__(self, observations: Observations, model: MotionModel) -> None:
        self.model = model
        self.view, self.xy = observations.view, np.ascontiguousarray(observations.xy)
        self.start = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
        self.translations = model.index[:, -2:].ravel()

    def scaled(self, step: FloatArray) -> FloatArray:
        """Return a step with translations in units of 100 px, so that one limit serves all parameters."""
        scaled = step.copy()
        scaled[self.translations] /= TRANSLATION_SIGMA_PX
        return scaled

    def minimize(self, parameters: FloatArray, weights: FloatArray, *, max_steps: int) -> tuple[FloatArray, float, int]:
        """Run Levenberg-Marquardt to the bottom at fixed weights; return parameters, cost and steps."""
        damping = 1e-6
        equations = self.normal_equations(parameters, weights)
        steps = 0
        while steps < max_steps:
            steps += 1
            diagonal = np.diag(equations.hessian)
            try:
                solution = np.linalg.solve(equations.hessian + damping * np.diag(diagonal), equations.gradient)
            except np.linalg.LinAlgError as error:
                raise DegenerateGeometryError(UNDETERMINED) from error
            step = np.asarray(solution, dtype=np.float64)
            candidate = self.normal_equations(parameters + step, weights)
            if candidate.cost <= equations.cost:
                gain = equations.cost - candidate.cost
                parameters, equations = parameters + step, candidate
                damping = max(damping / 10, 1e-15)
                if gain <= _RELATIVE_TOLERANCE * equations.cost and np.abs(self.scaled(step)).max() < 1e-9:
                    break
            else:
                if np.abs(self.scaled(step)).max() < 1e-10:
                    break
                damping *= 10
        return parameters, equations.cost, steps

    def normal_equations(self, parameters: FloatArray, weights: FloatArray) -> NormalEquations:
        """Build the camera system after the points are eliminated, priors included."""
        blocks, gradients, cost = camera_equations(
            self.start, self.view, self.xy, weights, *self.model.cameras(parameters)
        )
        if not np.isfinite(cost):
            raise DegenerateGeometryError(UNDETERMINED)
        size = len(parameters)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        index, prior_index, prior_weight = self.model.index, self.model.prior_index, self.model.prior_weight
        np.add.at(hessian, (index[:, :, None, None], index), blocks)
        np.add.at(gradient, index, gradients)
        deviation = self.prior_deviation(parameters)
        hessian[prior_index, prior_index] += prior_weight**2
        gradient[prior_index] -= deviation * prior_weight
        # A common shift of the world moves no image: this holds the translations without pulling on them.
        hessian[self.translations, self.translations] += TRANSLATION_SIGMA_PX**-2
        return NormalEquations(hessian, gradient, cost + float(deviation @ deviation))

    def prior_deviation(self, parameters: FloatArray) -> FloatArray:
        """Return how far the parameters are from their priors, in sigmas."""
        deviation: FloatArray = (parameters[self.model.prior_index] - self.model.prior_centre) * self.model.prior_weight
        return deviation

    def residuals(self, parameters: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the residuals (K, 2) px, every point at its best for the given weights."""
        return self.triangulate(parameters, weights)[2]

    def cauchy_weights(self, parameters: FloatArray, sigma_px: float) -> FloatArray:
        """Return the robust weights (K,) of the observations for noise `sigma_px`."""
        matrices, _, translations = self.model.cameras(parameters)
        weights: FloatArray = cauchy_weights(
            self.start, self.view, self.xy, matrices, translations, _CAUCHY * sigma_px, _ROUNDS_PER_POINT
        )
        return weights

    def triangulate(self, parameters: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the points (P, 3) for given cameras, the covariances of their own noise, and residuals (K, 2) px."""
        matrices, _, translations = self.model.cameras(parameters)
        points, covariance, residual = solve_points(self.start, self.view, self.xy, weights, matrices, translations)
        if not np.isfinite(points).all():
            raise DegenerateGeometryError(UNDETERMINED)
        return points, covariance, residual
