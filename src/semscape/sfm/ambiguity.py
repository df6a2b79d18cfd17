"""What parallel projections leave open: the mirror image, and the valley of reliefs tilted less and stretched more."""

from __future__ import annotations

import math

import numpy as np

from semscape.errors import DegenerateGeometryError
from semscape.options import SfmOptions
from semscape.sfm.adjust import Adjustment, Problem, adjust, robust_cost
from semscape.sfm.models import PARAMETERS_PER_VIEW, TiltSeriesModel
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, Observations

_LEAST_VIEWS = 3
_NOTHING_KNOWN = 10.0


def mirror_margin(
    observations: Observations, found: Adjustment, prior: MotionPrior, options: SfmOptions, overdispersion: float
) -> float:
    """Return by how much the mirrored motion, refined from its own start, costs more than the one found.

    The unit is twice the negative log-posterior, so that 6 is a likelihood ratio of 20. The residuals of a relief and
    of its mirror image under opposite tilts are the same, so the margin comes from the priors: it is near 0 where
    nothing but the shading tells them apart, and negative where the mirrored motion is the better one.
    """
    mirrored = found.parameters.copy()
    mirrored[1::PARAMETERS_PER_VIEW] *= -1
    other = adjust(
        mirrored, observations, prior, max_iterations=options.max_iterations, overdispersion=overdispersion
    ).parameters
    # Where the prior draws the mirrored start back over zero tilt, it ends where we are: then its start is the mirror.
    same_side = float(other[1::PARAMETERS_PER_VIEW] @ found.parameters[1::PARAMETERS_PER_VIEW]) > 0
    costs = [
        robust_cost(parameters, observations, TiltSeriesModel(prior), found.sigma_px, overdispersion)
        for parameters in (found.parameters, mirrored if same_side else other)
    ]
    return costs[1] - costs[0]


def images_height_scale_sigma(
    observations: Observations, found: Adjustment, prior: MotionPrior, overdispersion: float
) -> float:
    """Return the height scale's relative sigma as the images alone give it: how narrow the bas-relief valley is.

    Infinite where they give nothing: two views.
    """
    model = TiltSeriesModel(prior.without_stage())
    if prior.n_views < _LEAST_VIEWS:
        return np.inf
    information = found.weights / (found.sigma_px**2 * overdispersion)
    hessian = Problem(observations, model).normal_equations(found.parameters, information).hessian
    if np.linalg.eigvalsh(hessian)[0] <= 0:
        return np.inf
    try:
        covariance = model.covariance(hessian, found.parameters)[1::PARAMETERS_PER_VIEW, 1::PARAMETERS_PER_VIEW]
    except DegenerateGeometryError:
        return np.inf
    sigma = height_scale_relative_sigma(found.parameters[1::PARAMETERS_PER_VIEW], covariance)
    return sigma if sigma < _NOTHING_KNOWN else np.inf


def height_scale_relative_sigma(tilt_rad: FloatArray, tilt_covariance: FloatArray) -> float:
    """Return the relative sigma of all heights: that of the tilts' spread about their mean.

    Examples
    --------
    Two views 8 deg apart, each known to 0.1 deg:

    >>> tilt, covariance = np.deg2rad([-4.0, 4.0]), np.eye(2) * np.deg2rad(0.1) ** 2
    >>> round(height_scale_relative_sigma(tilt, covariance), 4)
    0.0177
    """
    deviation = tilt_rad - tilt_rad.mean()
    gradient = deviation / max(float(deviation @ deviation), 1e-18)
    variance = float(gradient @ tilt_covariance @ gradient)
    return math.sqrt(variance) if variance >= 0 else math.nan  # rounding has eaten a nearly singular covariance
