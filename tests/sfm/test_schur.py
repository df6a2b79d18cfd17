"""The eliminated normal equations against dense ones over every point and camera."""

from __future__ import annotations

import numpy as np

from semscape.sfm.models import camera_jacobians
from semscape.sfm.schur import camera_equations, cauchy_weights, solve_points

RNG = np.random.default_rng(0)
VIEWS, POINTS = 4, 12
VISIBLE = RNG.uniform(size=(POINTS, VIEWS)) < 0.7
VISIBLE[:, :2] = True
POINT, VIEW = np.nonzero(VISIBLE)
START = np.searchsorted(POINT, np.arange(POINTS + 1))
PARAMETERS = RNG.normal(0, 0.2, 1 + 6 * VIEWS)
CAMERAS = camera_jacobians(PARAMETERS, RNG.uniform(5, 10, VIEWS))
XY = RNG.normal(0, 30, (len(POINT), 2))
WEIGHTS = RNG.uniform(0.2, 3, len(POINT))


def dense() -> tuple[np.ndarray, np.ndarray, float]:
    """Return the Schur complement of J^T W J with 7 columns per view and 3 per point, and its right-hand side."""
    matrices, derivatives, translations = CAMERAS
    points, _, residual = solve_points(START, VIEW, XY, WEIGHTS, matrices, translations)
    jacobian = np.zeros((2 * len(POINT), 7 * VIEWS + 3 * POINTS))
    for k, (view, point) in enumerate(zip(VIEW, POINT, strict=True)):
        rows = slice(2 * k, 2 * k + 2)
        jacobian[rows, 7 * view : 7 * view + 5] = (derivatives[view] @ points[point]).T
        jacobian[rows, 7 * view + 5 : 7 * view + 7] = np.eye(2)
        jacobian[rows, 7 * VIEWS + 3 * point : 7 * VIEWS + 3 * point + 3] = matrices[view]
    weight = np.repeat(WEIGHTS, 2)
    normal = jacobian.T @ (weight[:, None] * jacobian)
    right = jacobian.T @ (weight * residual.ravel())
    n = 7 * VIEWS
    schur = normal[:n, :n] - normal[:n, n:] @ np.linalg.solve(normal[n:, n:], normal[n:, :n])
    return schur, right[:n], float(weight @ residual.ravel() ** 2)


def test_the_equations_are_those_of_the_whole_problem() -> None:
    blocks, gradient, cost = camera_equations(START, VIEW, XY, WEIGHTS, *CAMERAS)
    schur, right, expected = dense()
    np.testing.assert_allclose(blocks.reshape(7 * VIEWS, 7 * VIEWS), schur, atol=1e-9 * np.abs(schur).max())
    np.testing.assert_allclose(gradient.ravel(), right, atol=1e-9 * np.abs(right).max())
    assert np.isclose(cost, expected)


def test_points_are_the_least_squares_ones() -> None:
    matrices, _, translations = CAMERAS
    points, covariance, residual = solve_points(START, VIEW, XY, WEIGHTS, matrices, translations)
    for point in range(POINTS):
        k = np.arange(START[point], START[point + 1])
        stacked = (matrices[VIEW[k]] * np.sqrt(WEIGHTS[k])[:, None, None]).reshape(-1, 3)
        right = ((XY[k] - translations[VIEW[k]]) * np.sqrt(WEIGHTS[k])[:, None]).ravel()
        np.testing.assert_allclose(points[point], np.linalg.lstsq(stacked, right, rcond=None)[0], rtol=1e-6)
        np.testing.assert_allclose(covariance[point], np.linalg.inv(stacked.T @ stacked), rtol=1e-6)
    assert residual.shape == XY.shape


def test_robust_weights_single_out_the_wrong_view() -> None:
    matrices, _, translations = CAMERAS
    world = RNG.normal(0, 3, (1, 3))
    xy = (matrices @ world[0]) + translations
    xy[2] += 50.0
    weights = cauchy_weights(np.array([0, 4]), np.arange(4), xy, matrices, translations, 1.0, 8)
    assert weights[2] < 0.01
    assert np.delete(weights, 2).min() > 0.2
