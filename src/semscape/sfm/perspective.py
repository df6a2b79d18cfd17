"""Is the projection parallel? The perspective camera with a long distance, against the scaled orthographic one.

The perspective term is a small correction to parallel projection, nearly linear in the inverse distance of the centre
of projection. So observations are corrected by it, for given cameras and points, and the parallel model is adjusted to
what is left, until both agree; the inverse distance itself finds its bottom on a few parabolas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from semscape.geometry.cameras import PerspectiveCamera, ScaledOrthographicCamera
from semscape.sfm.adjust import Adjustment, robust_cost
from semscape.sfm.models import TiltSeriesModel
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, Observations

Refit = Callable[[FloatArray, Observations], Adjustment]
CamerasAt = Callable[[FloatArray, float], tuple[tuple[ScaledOrthographicCamera, ...], tuple[PerspectiveCamera, ...]]]
_ROUNDS = 3
_PARABOLAS = 6
_DOUBLINGS = 12


@dataclass(frozen=True)
class PerspectiveFit:
    """The perspective camera at its best.

    `inverse_distance_per_um` of the centre of projection with its sigma; `margin` by which its Bayesian information
    criterion is better than parallel projection's (negative where parallel projection is the better model);
    `observations` as parallel projection would have shown them, and the `adjustment` to them.
    """

    inverse_distance_per_um: float
    sigma_per_um: float
    margin: float
    observations: Observations
    adjustment: Adjustment

    def is_possible(self, relief_sign: float) -> bool:
        """Whether the centre of projection lies on the source's side, beyond every point; -1 mirrors the relief."""
        height_share = self.inverse_distance_per_um * self.adjustment.points_um[:, 2]
        return relief_sign * self.inverse_distance_per_um > 0 and float(height_share.max()) < 1


def fit_perspective(
    parallel: Adjustment,
    observations: Observations,
    prior: MotionPrior,
    refit: Refit,
    cameras_at: CamerasAt,
    *,
    overdispersion: float,
) -> PerspectiveFit:
    """Fit the inverse distance of the centre of projection, with cameras and points adjusted anew at each value.

    Parameters
    ----------
    parallel : Adjustment
        The bottom under parallel projection.
    observations : Observations
    prior : MotionPrior
    refit : callable
        Adjusts from a start (parameters, observations).
    cameras_at : callable
        Both kinds of cameras for parameters and an inverse distance.
    overdispersion : float

    References
    ----------
    Schwarz 1978, doi:10.1214/aos/1176344136 (information criterion).
    """
    sigma_px, model = parallel.sigma_px, TiltSeriesModel(prior)

    def correction(found: Adjustment, inverse_distance: float) -> FloatArray:
        parallel_cameras, cameras = cameras_at(found.parameters, inverse_distance)
        points = found.points_um
        shift = np.stack(
            [far.project(points) - flat.project(points) for flat, far in zip(parallel_cameras, cameras, strict=True)]
        )
        chosen: FloatArray = shift[observations.view, observations.point]
        return chosen

    def fitted(inverse_distance: float, found: Adjustment) -> tuple[Observations, Adjustment, float]:
        for _ in range(_ROUNDS):
            corrected = replace(observations, xy=observations.xy - correction(found, inverse_distance))
            found = refit(found.parameters, corrected)
        return corrected, found, robust_cost(found.parameters, corrected, model, sigma_px, overdispersion)

    unit = 1e-6 / float(np.ptp(parallel.points_um[:, :2]))
    step = unit * 3 * sigma_px / float(np.sqrt(np.mean(correction(parallel, unit) ** 2)))
    corrected, found, cost_of_parallel = fitted(0.0, parallel)
    best, cost = 0.0, cost_of_parallel
    # Far from the bottom the robust cost is no parabola: walk downhill in growing steps first.
    beside = {sign: fitted(sign * step, found) for sign in (-1, 1)}
    down = min(beside, key=lambda sign: beside[sign][2])
    place, there = down * step, beside[down]
    for _ in range(_DOUBLINGS):
        if there[2] >= cost:
            break
        best, (corrected, found, cost) = place, there
        place *= 2
        there = fitted(place, found)
    for _ in range(_PARABOLAS):
        below, above = (fitted(best + sign * step, found)[2] for sign in (-1, 1))
        curvature = (below - 2 * cost + above) / step**2
        if curvature <= 0:
            return PerspectiveFit(0.0, np.inf, -np.inf, observations, parallel)
        move = (below - above) / (2 * step) / curvature
        best += move
        corrected, found, cost = fitted(best, found)
        if abs(move) < step / 10:
            break
    n_free = 2 * len(observations.view) - 3 * observations.n_points
    margin = cost_of_parallel - cost - float(np.log(max(n_free / overdispersion, 1.0)))
    return PerspectiveFit(best, float(np.sqrt(2 / curvature)), margin, corrected, found)
