"""The most probable surface against closed forms: dense solve, diagonal of the inverse, a prior drawn from."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.dense.evidence import begin, refine_by_evidence
from semscape.dense.posterior import (
    DataTerm,
    LatticeTable,
    Smoothness,
    averaging_width,
    height_variance,
    most_probable,
    second_differences,
    smoothness_by_evidence,
    smoothness_cut,
)
from synthetic_views import COLUMNS, SHAPE, look_at

SMALL = (9, 11)


def second_difference_matrix(shape: tuple[int, int], cut) -> np.ndarray:
    """Return D, a row for each second difference, xy counted twice as in |D2 h|^2 = xx^2 + yy^2 + 2 xy^2."""
    size = shape[0] * shape[1]
    columns = [second_differences(unit.reshape(shape)) for unit in np.eye(size)]
    return np.concatenate(
        [np.stack([np.sqrt(f * w) * d[k] for d in columns], axis=-1).reshape(-1, size) for k, (f, w) in enumerate(cut)]
    )


def prior_of(tau2: float, shape: tuple[int, int] = SMALL) -> Smoothness:
    return Smoothness(np.full(shape, tau2), np.ones(shape))


def test_the_solution_is_that_of_the_dense_matrix() -> None:
    rng = np.random.default_rng(0)
    height, stiffness, pull = rng.normal(size=SMALL), rng.uniform(0.2, 2, SMALL), rng.normal(size=SMALL)
    cut = smoothness_cut(np.where(np.arange(11) < 5, 0.0, 9.0) * np.ones((9, 1)), 1.0)
    d = second_difference_matrix(SMALL, [(1, cut[0]), (1, cut[1]), (2, cut[2])])
    matrix = np.diag(stiffness.ravel()) + d.T @ d / 0.5
    exact = np.linalg.solve(matrix, (stiffness * height + pull).ravel()).reshape(SMALL)
    target, found = stiffness * height + pull, height
    for _ in range(6):
        found = most_probable(found, DataTerm(stiffness, target - stiffness * found), cut, prior_of(0.5))
    np.testing.assert_allclose(found, exact, atol=1e-4)


def test_no_smoothness_reaches_across_a_jump() -> None:
    step = np.where(np.arange(40) < 20, 0.0, 30.0) * np.ones((30, 1))
    noisy = step + np.random.default_rng(1).normal(0, 0.5, step.shape)
    cut = smoothness_cut(noisy, 10.0)
    found = most_probable(noisy, DataTerm(np.ones(step.shape), np.zeros(step.shape)), cut, prior_of(1e-4, step.shape))
    assert np.abs(found - step).max() < 0.5
    assert np.std(found - step) < 0.15


def test_unknown_heights_take_no_part() -> None:
    height = np.zeros((12, 12))
    height[5, 5] = np.nan
    for weight in smoothness_cut(height, 1.0):
        assert weight[8:10, 8:10].all()
    assert smoothness_cut(height, 1.0)[0][5, 4:7].sum() == 0


@pytest.mark.parametrize("x", [1e-3, 1.0, 30.0])
def test_the_variance_is_the_diagonal_of_the_inverse(x: float) -> None:
    shape = (32, 32)
    stiffness, tau2 = np.full(shape, 2.0), x / 2.0
    cut = smoothness_cut(np.zeros(shape), 1.0)
    d = second_difference_matrix(shape, [(1, cut[0]), (1, cut[1]), (2, cut[2])])
    inverse = np.linalg.inv(2.0 * np.eye(d.shape[1]) + d.T @ d / tau2)
    exact = np.diag(inverse).reshape(shape)[14:18, 14:18].mean()
    table, known = LatticeTable(), np.ones(shape, bool)
    found = height_variance(stiffness, known, prior_of(tau2, shape), table)[16, 16]
    assert found == pytest.approx(exact, rel=0.1)
    width = averaging_width(stiffness, known, prior_of(tau2, shape), table)[16, 16]
    assert width == pytest.approx(np.sqrt(1 / (2.0 * exact) / (4 * np.pi)), rel=0.1)


@pytest.mark.parametrize("tau", [0.1, 0.3])
def test_evidence_finds_the_curvature_of_the_surface(tau: float) -> None:
    """A surface drawn from the prior, seen through unit noise: tau comes back, though the data show far more."""
    rng = np.random.default_rng(2)
    shape = (160, 160)
    frequency = 2 * np.pi * np.fft.fftfreq(shape[0])
    response = 2 - 2 * np.cos(frequency)
    total = response[:, None] + response[None, :]
    total[0, 0] = np.inf
    surface = tau * np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) / total).real
    data = surface + rng.normal(0, 1, shape)
    stiffness, cut, table = np.ones(shape), smoothness_cut(np.zeros(shape), 1.0), LatticeTable()
    prior, height = prior_of(0.25, shape), data
    for _ in range(15):
        height = most_probable(height, DataTerm(stiffness, data - height), cut, prior)
        prior = smoothness_by_evidence(height, stiffness, cut, prior, table)
    found = float(np.sqrt(np.median(prior.variance)))
    # The weights take the tails of a Gaussian for edges, so tau comes out low.
    assert 0.4 < found / tau < 1.4
    assert np.std(height - surface) < 0.5 * np.std(data - surface)


def test_refining_lowers_the_error_and_knows_it() -> None:
    true = np.tile(20 + 6 * np.sin(COLUMNS / 25), (SHAPE[0], 1))
    rough = true + np.random.default_rng(4).normal(0, 0.5, SHAPE)
    found = refine_by_evidence(begin(rough, look_at(true[0]).baseline), look_at(true[0]), look_at(true[0]))
    inner = np.s_[15:-15, 25:-25]
    error = np.abs(found.height - true)[inner]
    assert np.sqrt(np.mean(error**2)) < 0.5 * 0.5
    assert 0.4 < np.mean(error < found.uncertainty[inner]) < 0.95


def test_sigma_holds_on_the_ridge_of_a_roof() -> None:
    """Smoothing rounds off a ridge, which the variance of the neighbourhood does not tell: without it 0.39."""
    true = np.tile(30 - np.abs(COLUMNS - 75), (SHAPE[0], 1))
    found = refine_by_evidence(begin(true, look_at(true[0]).baseline), look_at(true[0]), look_at(true[0]))
    ridge = np.s_[15:-15, 73:78]
    assert 0.5 < np.mean(np.abs(found.height - true)[ridge] < found.uncertainty[ridge]) < 0.9


def test_drift_makes_more_of_heights_that_fewer_views_see() -> None:
    """Each view is shifted as a whole. Two neighbours of five hold a twentieth of the baseline's square."""
    views = look_at(np.zeros(SHAPE[1]), noise=1.0)
    for sampler, shift in zip(views.samplers, (0.3, -0.45, 0.1, 0.35, -0.3), strict=True):
        sampler.x0 = sampler.x0 + np.float32(shift)
    for view in (0, 1, 4):
        views.samplers[view].mask[:, 75:] = 0
    found = refine_by_evidence(begin(np.zeros(SHAPE), views.baseline), views, views)
    all_see, few_see = np.s_[15:-15, 20:55], np.s_[15:-15, 90:-20]
    assert np.median(found.n_views[all_see]) == 5
    assert np.median(found.n_views[few_see]) == 2
    assert np.median(found.slow_share[few_see]) == pytest.approx(20)
    ratio = np.nanmedian(found.uncertainty[few_see]) / np.nanmedian(found.uncertainty[all_see])
    assert 3 < ratio < 6


def test_what_is_black_in_all_views_has_no_height() -> None:
    """All views are equal there, whatever the height; the rim of what is beside it must not speak for it."""
    views = look_at(np.zeros(SHAPE[1]), noise=1.0)
    for sampler in views.samplers:
        sampler.image[:, 80:] = sampler.along[:, 80:] = 0
    found = refine_by_evidence(begin(np.zeros(SHAPE), views.baseline), views, views)
    assert np.isfinite(found.height[15:-15, 20:75]).mean() > 0.95
    assert np.isnan(found.height[:, 102:]).all()


def test_an_unknown_map_stays_unknown() -> None:
    unknown = np.full(SHAPE, np.nan)
    nothing = look_at(np.zeros(SHAPE[1]))
    assert np.isnan(refine_by_evidence(begin(unknown, nothing.baseline), nothing, nothing).height).all()
