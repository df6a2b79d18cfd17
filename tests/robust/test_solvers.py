"""Minimal solvers and least-squares models against matrices that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.robust import refit
from semscape.robust.five_point import solve_essential
from semscape.robust.minimal import solve_affine, solve_fundamental, solve_homography
from semscape.robust.polynomials import null_space, real_roots
from synthetic_pairs import difference, line_distances, pair_of_views, perspective_views

SAMPLES = 200


def solved(solve, w: np.ndarray, size: int, most: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    samples = np.array([rng.choice(len(w), size, replace=False) for _ in range(SAMPLES)])
    matrices, count = np.zeros((SAMPLES, most, 3, 3)), np.zeros(SAMPLES, np.int64)
    solve(w, samples, matrices, count)
    return matrices, count


def nearest(matrices: np.ndarray, count: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.array(
        [min([difference(m, truth) for m in row[:n]], default=np.inf) for row, n in zip(matrices, count, strict=True)]
    )


def test_seven_points_hold_the_true_matrix() -> None:
    x1, x2, truth, _ = perspective_views(300, 0.0, 2)
    w = np.hstack([x1, x2]) / 800
    scale = np.diag([800.0, 800.0, 1.0])
    matrices, count = solved(solve_fundamental, w, 7, 3)
    assert set(count.tolist()) <= {1, 2, 3}
    errors = nearest(matrices, count, scale @ truth @ scale)
    assert np.median(errors) < 1e-9
    assert (errors < 1e-4).mean() > 0.98
    for row, n in zip(matrices, count, strict=True):
        for matrix in row[:n]:
            assert abs(np.linalg.det(matrix / np.linalg.norm(matrix))) < 1e-10


def test_five_points_hold_the_true_matrix() -> None:
    x1, x2, truth, calibration = perspective_views(300, 0.0, 3)
    rays = np.hstack([(x - calibration[:2, 2]) / 700.0 for x in (x1, x2)])
    matrices, count = solved(solve_essential, rays, 5, 10)
    errors = nearest(matrices, count, calibration.T @ truth @ calibration)
    assert np.median(errors) < 1e-9
    assert (errors < 1e-4).mean() > 0.98
    assert 3 < count.mean() < 6  # 4.55 in the mean: Nister 2004, section 6
    values = np.array([np.linalg.svd(m)[1] for row, n in zip(matrices, count, strict=True) for m in row[:n]])
    off = np.abs(values / values[:, :1] - [1, 1, 0]).max(axis=1)
    assert np.median(off) < 1e-9
    assert (off < 1e-4).mean() > 0.98


def test_four_points_hold_the_true_homography() -> None:
    rng = np.random.default_rng(0)
    truth = np.array([[1.02, 0.03, 0.1], [-0.02, 0.97, 0.05], [0.01, -0.02, 1.0]])
    x1 = rng.uniform(-0.5, 0.5, (100, 2))
    mapped = np.column_stack([x1, np.ones(100)]) @ truth.T
    w = np.hstack([x1, mapped[:, :2] / mapped[:, 2:]])
    errors = nearest(*solved(solve_homography, w, 4, 1), truth)
    assert (errors < 1e-8).mean() > 0.97
    # Turned over, a plane shows its back, which no camera above it sees.
    turned = w * [1, 1, -1, 1]
    turned[:50] = w[:50]
    _, count = solved(solve_homography, turned, 4, 1)
    assert 0.05 < count.mean() < 0.6
    assert solved(solve_homography, w * [1, 1, -1, 1], 4, 1)[1].all()  # all of them: a mirror image, consistently


def test_four_points_hold_the_true_affine_matrix() -> None:
    x1, x2, _ = pair_of_views(200, 0.0, 0.0, 1)
    w = (np.hstack([x1, x2]) - 400) / 800
    errors = nearest(*solved(solve_affine, w, 4, 1), refit.fit_affine(w))
    assert np.median(errors) < 1e-9


def test_least_squares_of_exact_matches_is_exact() -> None:
    x1, x2, truth, _ = perspective_views(60, 0.0, 5)
    w, scale = np.hstack([x1, x2]) / 800, np.diag([800.0, 800.0, 1.0])
    assert difference(refit.fit_fundamental(w), scale @ truth @ scale) < 1e-8
    plane = np.array([[1.02, 0.03, 0.1], [-0.02, 0.97, 0.05], [0.01, -0.02, 1.0]])
    mapped = np.column_stack([w[:, :2], np.ones(60)]) @ plane.T
    assert difference(refit.fit_homography(np.hstack([w[:, :2], mapped[:, :2] / mapped[:, 2:]])), plane) < 1e-8


def test_the_essential_matrix_of_noisy_matches_is_essential_and_near() -> None:
    x1, x2, truth, calibration = perspective_views(400, 0.5, 5)
    rays = np.hstack([(x - calibration[:2, 2]) / 700.0 for x in (x1, x2)])
    found = refit.fit_essential(rays)
    np.testing.assert_allclose(np.linalg.svd(found)[1], [1, 1, 0], atol=1e-12)
    true_px = np.median(line_distances(truth, x1, x2))
    inverse = np.linalg.inv(calibration)
    assert np.median(line_distances(inverse.T @ found @ inverse, x1, x2)) < 1.03 * true_px


def test_too_few_matches_have_no_least_squares() -> None:
    w = np.random.default_rng(0).uniform(0, 1, (4, 4))
    assert refit.fit_affine(w) is refit.fit_fundamental(w) is refit.fit_homography(w) is None
    assert refit.fit_fundamental(np.ones((30, 4))) is None


@pytest.mark.parametrize("m", [5, 7, 8])
def test_the_null_space_is_null(m: int) -> None:
    equations = np.random.default_rng(m).normal(size=(m, 9))
    basis = np.empty((9 - m, 9))
    assert null_space(equations.copy(), basis)
    np.testing.assert_allclose(equations @ basis.T, 0, atol=1e-12)
    assert np.linalg.matrix_rank(basis) == 9 - m
    equations[-1] = equations[0] + equations[1]
    assert not null_space(equations, basis)


def test_roots_are_found_however_far_they_lie() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        truth = np.sort(rng.normal(0, 1, 6) * 10 ** rng.uniform(-2, 3, 6))
        coefficients = np.polynomial.polynomial.polyfromroots([*truth, 1j, -1j, 2 + 3j, 2 - 3j]).real
        roots = np.empty(11)
        assert real_roots(coefficients, roots) == 6
        np.testing.assert_allclose(roots[:6], truth, rtol=1e-5)
    assert real_roots(np.array([1.0, 0.0, 1.0]), roots) == 0
    assert real_roots(np.array([-4.0, 2.0, 0.0]), roots) == 1  # a leading zero is no root at infinity
    assert roots[0] == pytest.approx(2.0)
    assert real_roots(np.array([3.0]), roots) == 0
