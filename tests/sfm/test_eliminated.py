"""The objective with the structure eliminated, against plain least squares over every point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.options import SfmOptions
from semscape.sfm.eliminated import eliminated_cost, pattern_scatters, projection_matrices
from semscape.sfm.evolve import evolve
from semscape.sfm.priors import motion_prior
from synthetic_tracks import PIXEL_UM, make_tracks

TRACKS = make_tracks(n_points=150, seen=0.6, stage_deg=(-8.0, -4.0, 0.0, 4.0, 8.0))
SCALE = np.full(5, 1 / PIXEL_UM)


def random_parameters(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    parameters = np.zeros((count, 21))
    parameters[:, 0] = rng.uniform(-0.7, 2.3, count)
    parameters[:, 1::4] = rng.uniform(-0.4, 0.4, (count, 5))
    parameters[:, 2::4] = rng.normal(0, 0.01, (count, 5))
    parameters[:, 3::4] = rng.normal(0, 0.01, (count, 5))
    parameters[:, 4::4] = rng.normal(0, 0.002, (count, 5))
    return parameters


def brute_force(matrices: np.ndarray) -> float:
    """Return the least squared reprojection error over all points, the mean of each visibility pattern taken out."""
    seen = [tuple(TRACKS.observations.view[TRACKS.observations.point == p]) for p in range(150)]
    total = 0.0
    for pattern in set(seen):
        members = [p for p in range(150) if seen[p] == pattern]
        w = np.array([TRACKS.observations.xy[TRACKS.observations.point == p].ravel() for p in members])
        w = w - w.mean(axis=0)
        stacked = matrices[list(pattern)].reshape(-1, 3)
        points = np.linalg.lstsq(stacked, w.T, rcond=None)[0]
        total += float(((w.T - stacked @ points) ** 2).sum())
    return total


def test_eliminated_cost_equals_least_squares_over_all_points() -> None:
    patterns = pattern_scatters(TRACKS.observations, 5, np.ones(150))
    assert len(patterns.n_views) > 10
    matrices = projection_matrices(random_parameters(6), SCALE)
    expected = [brute_force(one) for one in matrices]
    np.testing.assert_allclose(eliminated_cost(matrices, patterns), expected, rtol=1e-5)


def test_a_population_is_scored_as_its_members_are() -> None:
    patterns = pattern_scatters(TRACKS.observations, 5, np.ones(150))
    matrices = projection_matrices(random_parameters(9), SCALE)
    together = eliminated_cost(matrices, patterns)
    np.testing.assert_array_equal(together, [eliminated_cost(one[None], patterns)[0] for one in matrices])


def test_weight_zero_leaves_a_track_out() -> None:
    weight = np.ones(150)
    weight[50:] = 0
    patterns = pattern_scatters(TRACKS.observations, 5, weight)
    few = TRACKS.observations
    kept = few.point < 50
    alone = pattern_scatters(replace(few, view=few.view[kept], point=few.point[kept], xy=few.xy[kept]), 5, np.ones(50))
    matrices = projection_matrices(random_parameters(3), SCALE)
    np.testing.assert_allclose(eliminated_cost(matrices, patterns), eliminated_cost(matrices, alone), rtol=1e-9)


def test_the_true_motion_costs_no_more_than_the_noise() -> None:
    clean = make_tracks(n_points=300, noise_px=0.0, seen=1.0)
    motion = clean.motion
    parameters = np.concatenate(
        [
            [motion.axis_angle_rad],
            np.column_stack(
                [motion.tilt_rad, motion.roll_rad, motion.scale_px_per_um * PIXEL_UM - 1, motion.anisotropy]
            ).ravel(),
        ]
    )
    patterns = pattern_scatters(clean.observations, 5, np.ones(300))
    cost = eliminated_cost(projection_matrices(parameters[None], SCALE), patterns)[0]
    assert cost < 0.1  # px^2 over 3000 coordinates; a ridge keeps equal tilts finite
    other = parameters.copy()
    other[1] += 0.01
    assert eliminated_cost(projection_matrices(other[None], SCALE), patterns)[0] > 1.0


@pytest.mark.parametrize("staged", [True, False])
def test_evolution_comes_to_the_same_bottom_from_any_seed(staged: bool) -> None:
    tilts = (-8.0, -4.0, 0.0, 4.0, 8.0)
    tracks = make_tracks(tilts, stage_deg=tilts if staged else None, n_points=300)
    options = SfmOptions()
    prior = motion_prior(tracks.series, options)
    patterns = pattern_scatters(tracks.observations, 5, np.ones(300))
    found = [evolve(patterns, prior, 0.4, options, rng=np.random.default_rng(seed)) for seed in range(3)]
    cost = np.array([one.cost for one in found])
    assert np.ptp(cost) < 0.05 * cost.min()
    for one in found:
        assert (np.diff(one.best_cost) <= 1e-9).all()  # it never loses its best
        assert 10 < len(one.best_cost) <= options.de_generations
        steps = np.abs(np.diff(np.rad2deg(one.parameters[1::4])))
        np.testing.assert_allclose(steps, 4.0, atol=0.6 if staged else 1.5)
