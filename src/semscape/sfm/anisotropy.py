"""How far scans stretch in x against y, learnt from the series: it decides how far a tilt is trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semscape.sfm.adjust import Adjustment, Problem, adjust
from semscape.sfm.models import PARAMETERS_PER_VIEW, TiltSeriesModel, by_anisotropy_sigma
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, Observations

_ROUNDS = 2
# Three views leave two equations over for three anisotropies: that they agree by chance tells of no quiet scan.
_VIEWS_THAT_TELL = 4
# Sigmas that are weighed, in units of the one told, evenly spaced in the logarithm.
_LEAST, _MOST, _STEPS = 0.02, 6.0, 40
# Even odds that the scans are as quiet as they like, or stretch as told, give or take the factor e^0.5.
_LOUDEST_OF_QUIET, _SPREAD_OF_TOLD = 2.0, 0.5


def adjust_learning_anisotropy(
    first: Adjustment, observations: Observations, prior: MotionPrior, *, max_iterations: int, overdispersion: float
) -> tuple[MotionPrior, Adjustment]:
    """Adjust to the bottom, with the sigma of the scan's anisotropy learnt from the series itself.

    No two microscopes share that sigma, and it decides how far the images' tilts are trusted. So every sigma from a
    fiftieth of the told one to six times it gets a weight: its prior times the evidence of the images, the other
    parameters integrated out (Laplace approximation). From five views on the images tell a steady scan from one that
    stretches; of three they tell next to nothing, and what is told stands for the covariance.

    The estimate rests on the sigma whose tilts have the least expected error measured in their own sigmas, so that
    a quiet scan, if it is one, is not given up for a loud one. The covariance is that of all sigmas together, of three
    views that of the one told, about the estimate.

    Parameters
    ----------
    first : Adjustment
        A start.
    observations, max_iterations, overdispersion
        As in `adjust`.
    prior : MotionPrior

    Returns
    -------
    prior : MotionPrior
        With the sigma that the estimate rests on, and all sigmas with their weights, those of the covariance.
    adjustment : Adjustment

    References
    ----------
    MacKay 1992, doi:10.1162/neco.1992.4.3.415 (evidence); Gelman 2006, doi:10.1214/06-BA117A (priors of a variance
    that few groups share); Hoeting et al. 1999, doi:10.1214/ss/1009212519 (averaging over models).
    """
    told = prior.anisotropy_sigma
    sigmas, log_prior = sigmas_weighed(told)

    def adjusted(start: FloatArray) -> Adjustment:
        return adjust(start, observations, prior, max_iterations=max_iterations, overdispersion=overdispersion)

    found = adjusted(first.parameters)
    for _ in range(_ROUNDS):
        information = found.weights / (found.sigma_px**2 * overdispersion)
        model = TiltSeriesModel(prior)
        hessian = Problem(observations, model).normal_equations(found.parameters, information).hessian
        anisotropy = found.parameters[4::PARAMETERS_PER_VIEW]
        shift, covariance, log_evidence = by_anisotropy_sigma(hessian, anisotropy, prior.anisotropy_sigma, sigmas)
        log_weight = log_evidence + log_prior
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        tilt_shift = shift[:, 1::PARAMETERS_PER_VIEW]
        precision = weight / np.einsum("skk->s", covariance[:, 1::PARAMETERS_PER_VIEW, 1::PARAMETERS_PER_VIEW])
        mean = precision @ tilt_shift / precision.sum()
        taken = float(sigmas[np.argmin(((tilt_shift - mean) ** 2).sum(axis=1))])
        prior = replace(prior, anisotropy_sigma=taken, anisotropy_sigmas=sigmas, anisotropy_weights=weight)
        if prior.n_views < _VIEWS_THAT_TELL:
            prior = replace(prior, anisotropy_sigmas=np.array([told]), anisotropy_weights=np.ones(1))
        found = adjusted(found.parameters)
    return prior, found


def sigmas_weighed(told: float) -> tuple[FloatArray, FloatArray]:
    """Return the sigmas that may be, and the logarithms of their prior probabilities, for the one that is told.

    Examples
    --------
    >>> sigmas, log_prior = sigmas_weighed(0.001)
    >>> probability = np.exp(log_prior)
    >>> round(float(probability.sum()), 6), round(float(probability @ (sigmas < 0.0005)), 1)
    (1.0, 0.4)
    """
    ratio = np.geomspace(_LEAST, _MOST, _STEPS)
    quiet = (ratio <= _LOUDEST_OF_QUIET) / np.log(_LOUDEST_OF_QUIET / _LEAST)
    as_told = np.exp(-0.5 * (np.log(ratio) / _SPREAD_OF_TOLD) ** 2) / (_SPREAD_OF_TOLD * np.sqrt(2 * np.pi))
    density = 0.5 * quiet + 0.5 * as_told
    return told * ratio, np.log(density / density.sum())
