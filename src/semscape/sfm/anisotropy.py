"""How far scans stretch in x against y, learnt from the series: it decides how far a tilt is trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semscape.sfm.adjust import Adjustment, adjust
from semscape.sfm.models import PARAMETERS_PER_VIEW
from semscape.sfm.priors import MotionPrior
from semscape.types import Observations

_TOLD_IN_VIEWS = 4.0
_MOST_ROUNDS = 10
_LEARNT = 0.02
_REACH = 2.0


def adjust_learning_anisotropy(
    first: Adjustment, observations: Observations, prior: MotionPrior, *, max_iterations: int, overdispersion: float
) -> tuple[MotionPrior, Adjustment]:
    """Adjust to the bottom, with the sigma of the scan's anisotropy learnt from the series itself.

    No two microscopes share that sigma. The prior's own counts as four views with that scatter; what the
    series adds is found by expectation-maximization. Where the images do not tell it, it stays what it was.

    The interval is to hold for a scan that stretches so, but most stretch less, and an estimate that allows for more
    than there is follows the noise: so from images alone the estimate takes half of it, and the covariance all of
    it. A stage that tells the tilts outweighs such an estimate, and must not be pulled by a trust that may be wrong.

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
        With the learnt sigma; where no stage tells the tilts with half of it, and a reach of 2.
    adjustment : Adjustment

    References
    ----------
    Dempster, Laird & Rubin 1977, doi:10.1111/j.2517-6161.1977.tb01600.x.
    """
    told = prior.anisotropy_sigma
    found = first
    for _ in range(_MOST_ROUNDS):
        found = adjust(
            found.parameters, observations, prior, max_iterations=max_iterations, overdispersion=overdispersion
        )
        anisotropy = found.parameters[4::PARAMETERS_PER_VIEW]
        variance = np.diag(found.covariance)[4::PARAMETERS_PER_VIEW]
        evidence = float((anisotropy**2 + variance).sum())
        sigma = float(np.sqrt((_TOLD_IN_VIEWS * told**2 + evidence) / (_TOLD_IN_VIEWS + prior.n_views)))
        if abs(sigma / prior.anisotropy_sigma - 1) < _LEARNT:
            break
        prior = replace(prior, anisotropy_sigma=sigma)
    if not prior.self_calibrated:
        return prior, found
    prior = replace(prior, anisotropy_sigma=prior.anisotropy_sigma / _REACH, anisotropy_reach=_REACH)
    found = adjust(found.parameters, observations, prior, max_iterations=max_iterations, overdispersion=overdispersion)
    return prior, found
