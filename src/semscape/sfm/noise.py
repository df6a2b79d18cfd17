"""What the residuals tell of the noise: its size, and how much of it neighbours share."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2

from semscape.types import BoolArray, FloatArray, Observations

_INLIER_WEIGHT = 0.2
_CELLS = 4
_LEAST_PER_CELL = 10
_LEAST_LENGTH = 2
_REJECT_IN_SIGMAS = 5.0


def noise_sigma_px(residual_px: FloatArray, observations: Observations, weights: FloatArray) -> float:
    """Estimate the noise of one coordinate from the residuals (K, 2), robustly.

    A track of m views leaves 2 m - 3 of its 2 m residuals free, the rest is absorbed by its point: its squared
    residuals sum to sigma^2 times a chi-square of so many degrees of freedom. Observations of small weight (K,), which
    no longer pull at their points, are left out: of long tracks most hold an outlier. Medians over the tracks of each
    length keep out those that are left.
    """
    inlier = weights > _INLIER_WEIGHT
    length = np.bincount(observations.point[inlier])
    squared = np.bincount(observations.point[inlier], (residual_px[inlier] ** 2).sum(axis=1))
    total = tracks = 0.0
    for m in np.unique(length[length >= _LEAST_LENGTH]):
        of_length = squared[length == m]
        total += len(of_length) * float(np.median(of_length)) / float(chi2.median(2 * m - 3))
        tracks += len(of_length)
    return max(math.sqrt(total / max(tracks, 1.0)), 1e-3)


def without_outliers(
    observations: Observations, residual_px: FloatArray, sigma_px: float
) -> tuple[Observations, BoolArray]:
    """Drop observations beyond 5 sigma, and tracks left with fewer than two; the second value says which are kept."""
    keep = np.linalg.norm(residual_px, axis=1) < _REJECT_IN_SIGMAS * sigma_px * np.sqrt(free_share(observations))
    left = np.bincount(observations.point, keep, minlength=observations.n_points)
    keep &= left[observations.point] >= 2
    _, point = np.unique(observations.point[keep], return_inverse=True)
    return Observations(observations.view[keep], point.astype(np.int64), observations.xy[keep]), keep


def free_share(observations: Observations) -> FloatArray:
    """Return for each observation (K,) the share of its residual's variance that its point does not absorb."""
    length = np.bincount(observations.point)[observations.point]
    share: FloatArray = (2.0 * length - 3.0) / (2.0 * length)
    return share


def residual_overdispersion(
    residual_px: FloatArray, observations: Observations, weights: FloatArray, sigma_px: float, n_views: int
) -> float:
    """Estimate by how much neighbouring residuals move together: the variance inflation of smooth errors.

    Scan distortions shift whole regions of an image alike, so that N keypoints tell less about the motion than N
    independent ones. Over a 4 x 4 grid of each view and coordinate, the mean squared cell sum per keypoint is
    compared with the variance of independent residuals; 1 means independent.
    """
    standardized = residual_px / np.sqrt(free_share(observations))[:, None]
    inlier = weights > _INLIER_WEIGHT
    low, high = observations.xy[inlier].min(axis=0), observations.xy[inlier].max(axis=0)
    cell_xy = np.minimum((observations.xy - low) / (high - low + 1e-9) * _CELLS, _CELLS - 1).astype(np.int64)
    cell = (observations.view * _CELLS + cell_xy[:, 1]) * _CELLS + cell_xy[:, 0]
    size = n_views * _CELLS**2
    count = np.bincount(cell[inlier], minlength=size)
    filled = count >= _LEAST_PER_CELL
    if not filled.any():
        return 1.0
    ratios = [
        np.mean(np.bincount(cell[inlier], standardized[inlier, axis], minlength=size)[filled] ** 2 / count[filled])
        / sigma_px**2
        for axis in (0, 1)
    ]
    return float(max(1.0, np.mean(ratios)))
