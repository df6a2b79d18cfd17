"""Find the motion globally with Differential Evolution over the eliminated-structure objective."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution
from scipy.stats import chi2

from semscape.options import SfmOptions
from semscape.sfm.eliminated import (
    PatternScatters,
    eliminated_cost,
    pattern_scatters,
    projection_matrices,
    track_residuals,
)
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, Observations

_AXIS_BOUNDS_RAD = (-np.pi / 4, 3 * np.pi / 4)
_STAGE_BOUND_IN_SIGMAS = 10.0
_PRIOR_BOUND_IN_SIGMAS = 3.0
_MOST_PATTERNS = 32
_START_NOISE_PX = 0.4
_LEAST_NOISE_PX = 0.05
_WIDTH_IN_SIGMAS = 2.0


@dataclass(frozen=True)
class Evolution:
    """The best motion parameters (1 + 4 V,), its cost, and the best cost and member after every generation.

    `best_parameters` is (G, 1 + 4 V) for G generations, `best_cost` (G,).
    """

    parameters: FloatArray
    cost: float
    best_cost: FloatArray
    best_parameters: FloatArray
    n_evaluations: int


@dataclass(frozen=True)
class Search:
    """A search's end, the robustly weighted tracks that it ended on, and the noise that it found."""

    evolution: Evolution
    patterns: PatternScatters
    sigma_px: float


def search(observations: Observations, prior: MotionPrior, options: SfmOptions, *, rng: np.random.Generator) -> Search:
    """Search a motion among tracks of which some are wrong: evolve, weight the tracks by their misfit, evolve again.

    Parameters
    ----------
    observations : Observations
        Sorted by point, then view.
    prior, options, rng
        As in `evolve`.
    """
    patterns = pattern_scatters(observations, prior.n_views, np.ones(observations.n_points))
    found = evolve(patterns, prior, _START_NOISE_PX, options, rng=rng)
    matrices = projection_matrices(found.parameters[None], prior.scale_px_per_um)[0]
    squared, n_free = track_residuals(observations, matrices)
    sigma_px = max(float(np.sqrt(np.median(squared / chi2.median(n_free)))), _LEAST_NOISE_PX)
    weight = 1 / (1 + squared / n_free / (_WIDTH_IN_SIGMAS * sigma_px) ** 2) ** 2
    patterns = pattern_scatters(observations, prior.n_views, weight)
    again = evolve(patterns, prior, sigma_px, options, rng=rng)
    return Search(replace(again, n_evaluations=found.n_evaluations + again.n_evaluations), patterns, sigma_px)


def evolve(
    patterns: PatternScatters,
    prior: MotionPrior,
    sigma_px: float,
    options: SfmOptions,
    *,
    rng: np.random.Generator,
) -> Evolution:
    """Search axis, tilts, rolls and scales of a series globally.

    The cost is E / sigma^2 plus the squared priors. Scan anisotropy stays at zero: it is a correction that
    bundle adjustment finds.

    Parameters
    ----------
    patterns : PatternScatters
        The tracks.
    prior : MotionPrior
        Priors, which also bound the search.
    sigma_px : float
        Noise of a keypoint's coordinate.
    options : SfmOptions
        Strategy, population, generations and tolerance.
    rng : numpy.random.Generator

    References
    ----------
    Storn & Price 1997, doi:10.1023/A:1008202821328.
    """
    centre, sigma = prior.centre_and_sigma()
    free, bounds = _free_parameters(prior, centre, sigma)
    tight = np.isfinite(sigma)
    patterns = patterns.strongest(_MOST_PATTERNS)
    n_evaluations = 0
    costs: list[float] = []
    members: list[FloatArray] = []

    def population_cost(population: FloatArray) -> FloatArray:
        nonlocal n_evaluations
        n_evaluations += population.shape[1]
        parameters = np.tile(centre, (population.shape[1], 1))
        parameters[:, free] = population.T
        error = eliminated_cost(projection_matrices(parameters, prior.scale_px_per_um), patterns) / sigma_px**2
        deviation = (parameters[:, tight] - centre[tight]) / sigma[tight]
        cost: FloatArray = error + (deviation**2).sum(axis=1)
        return cost

    def record(intermediate_result: OptimizeResult) -> None:
        costs.append(float(intermediate_result.fun))
        members.append(intermediate_result.x.copy())

    found = differential_evolution(
        population_cost,
        bounds,
        strategy=options.de_strategy,
        maxiter=options.de_generations,
        popsize=options.de_population_per_variable,
        tol=options.de_tolerance,
        atol=0.0,
        mutation=(0.4, 0.9),
        recombination=0.9,
        rng=rng,
        callback=record,
        polish=False,
        init="sobol",
        updating="deferred",
        vectorized=True,
    )
    best = np.tile(centre, (len(members) + 1, 1))
    best[:, free] = [*members, found.x]
    return Evolution(best[-1], float(found.fun), np.array(costs), best[:-1], n_evaluations)


def _free_parameters(
    prior: MotionPrior, centre: FloatArray, sigma: FloatArray
) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """Return the indices of the searched parameters and their bounds.

    The reference view's tilt, roll and scale are held: a common change of them is no change of the images.
    """
    free, bounds = [0], [_AXIS_BOUNDS_RAD]
    if np.isfinite(prior.axis_sigma_rad):
        reach = _PRIOR_BOUND_IN_SIGMAS * prior.axis_sigma_rad
        bounds = [(centre[0] - reach, centre[0] + reach)]
    for view in range(prior.n_views):
        if view == prior.reference:
            continue
        for offset in (1, 2, 3):
            index = 4 * view + offset
            if np.isfinite(sigma[index]):
                reach = (_STAGE_BOUND_IN_SIGMAS if offset == 1 else _PRIOR_BOUND_IN_SIGMAS) * sigma[index]
            else:
                reach = prior.max_tilt_rad
            free.append(index)
            bounds.append((centre[index] - reach, centre[index] + reach))
    return np.array(free), bounds
