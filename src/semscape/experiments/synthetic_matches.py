"""Matches of two tilted parallel views with known truth: the material of `matching`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.robust.affine_epipolar import epipolar_distance_px
from semscape.types import BoolArray, FloatArray

SHAPE = (1536, 2048)
SHAPES = (SHAPE, SHAPE)
# Two views 6 deg apart of a relief of a tenth of the image's width, the axis upright: rows are epipolar lines.
_HALF_TILT_RAD = np.deg2rad(3.0)
_RELIEF_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class SyntheticPair:
    """Matches (M, 2) and (M, 2) in px, and which are `right` (M,) bool."""

    x1: FloatArray
    x2: FloatArray
    right: BoolArray

    def true_residual_px(self) -> FloatArray:
        """Return the distances (M,) to the true epipolar lines."""
        return epipolar_distance_px(np.array([0.0, 1.0, 0.0, -1.0, 0.0]), np.hstack([self.x1, self.x2]))

    def best_precision(self, recall: float) -> float:
        """Return the precision of the true geometry with the threshold that has this recall.

        Nothing that looks at the distance to epipolar lines alone can do better in the mean.
        """
        residual = self.true_residual_px()
        kept = residual <= np.quantile(residual[self.right], recall)
        return float(self.right[kept].mean())


def synthetic_pair(n: int, outlier_share: float, sigma_px: float, *, rng: np.random.Generator) -> SyntheticPair:
    """Return n matches: points seen twice with noise in both images, and points that have nothing in common."""
    height, width = SHAPE
    x, y = rng.uniform(0, width, n), rng.uniform(0, height, n)
    parallax = np.sin(_HALF_TILT_RAD) * rng.uniform(-0.5, 0.5, n) * _RELIEF_SHARE * width
    x1 = np.column_stack([x + parallax, y]) + rng.normal(0, sigma_px, (n, 2))
    x2 = np.column_stack([x - parallax, y]) + rng.normal(0, sigma_px, (n, 2))
    right = np.arange(n) >= round(outlier_share * n)
    x2[~right] = uniform_points(int((~right).sum()), rng=rng)
    return SyntheticPair(x1, x2, right)


def uniform_points(n: int, *, rng: np.random.Generator) -> FloatArray:
    """Return points (n, 2) anywhere in the image."""
    return rng.uniform(0, 1, (n, 2)) * (SHAPE[1], SHAPE[0])
