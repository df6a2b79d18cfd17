"""Matches of two views with known truth, for the tests of robust estimation."""

from __future__ import annotations

import numpy as np

from semscape.geometry.cameras import camera_matrices
from semscape.types import Motion

SHAPE = (600, 800)
SHAPES = (SHAPE, SHAPE)


def pair_of_views(
    n: int, outliers: float, noise_px: float, seed: int, relief_px: float = 90.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return matches of two views of random points under random tilts, and which of them are right."""
    rng = np.random.default_rng(seed)
    tilts = np.deg2rad([-rng.uniform(1, 5), rng.uniform(1, 5)])
    motion = Motion(
        rng.uniform(0, np.pi), tilts, np.deg2rad([0.1, -0.2]), np.array([1.0, 1.002]), np.zeros(2), np.zeros((2, 2))
    )
    points = np.column_stack(
        [rng.uniform(-380, 380, n), rng.uniform(-280, 280, n), rng.uniform(-relief_px, relief_px, n)]
    )
    centre = np.array([399.5, 299.5])
    x1, x2 = (points @ matrix.T + centre + rng.normal(0, noise_px, (n, 2)) for matrix in camera_matrices(motion))
    right = np.ones(n, dtype=bool)
    right[: round(outliers * n)] = False
    x2[~right] = rng.uniform(0, 1, (int((~right).sum()), 2)) * (SHAPE[1], SHAPE[0])
    return x1, x2, right


def perspective_views(n: int, noise_px: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return matches of two strongly perspective views, their fundamental matrix, and the calibration of both."""
    rng = np.random.default_rng(seed)
    calibration = np.array([[700.0, 0, 399.5], [0, 700, 299.5], [0, 0, 1]])
    points = np.column_stack([rng.uniform(-2, 2, n), rng.uniform(-1.5, 1.5, n), rng.uniform(4, 8, n)])
    angle = rng.uniform(0.1, 0.3)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    shift = np.array([-1.2, rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3)])
    rays = points @ calibration.T, (points @ turn.T + shift) @ calibration.T
    x1, x2 = (ray[:, :2] / ray[:, 2:] + rng.normal(0, noise_px, (n, 2)) for ray in rays)
    cross = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    inverse = np.linalg.inv(calibration)
    matrix = inverse.T @ cross @ turn @ inverse
    return x1, x2, matrix / np.linalg.norm(matrix), calibration


def line_distances(matrix: np.ndarray, x1: np.ndarray, x2: np.ndarray) -> np.ndarray:
    """Return the larger of the distances (n,) of the points to their epipolar lines, written out anew."""
    one, two = (np.column_stack([xy, np.ones(len(xy))]) for xy in (x1, x2))
    lines2, lines1 = one @ matrix.T, two @ matrix
    product = np.abs((two * lines2).sum(axis=1))
    return product / np.minimum(np.hypot(*lines1[:, :2].T), np.hypot(*lines2[:, :2].T))


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference of two matrices that are equal up to scale and sign."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return float(min(np.abs(a - b).max(), np.abs(a + b).max()))
