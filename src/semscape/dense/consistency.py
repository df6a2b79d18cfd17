"""How far the views agree on a height map: every view resampled at its heights, up to gain and offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semscape.dense.sampling import ViewSampler, gaussian_window
from semscape.types import BoolArray, FloatArray, ImageArray

_LEAST_CORRELATION = 0.3
_FULL_CORRELATION = 0.7
# Values are normalized: a window that holds less than this of their power is empty but for the rim of some texture.
_LEAST_POWER = 0.05

Stack = NDArray[np.float32]


@dataclass(frozen=True)
class ComparedViews:
    """Views at one height map: `values`, `slopes` along the parallax and `weights`, each (V, H, W), and their means.

    `total` (H, W) is the sum of the weights, `template` and `slope` the means over the views; `lever` (V, H, W) is each
    view's parallax against the mean one, `leverage` (H, W) the weighted sum of its squares.
    """

    values: Stack
    slopes: Stack
    weights: Stack
    total: ImageArray
    template: ImageArray
    slope: ImageArray
    lever: Stack
    leverage: ImageArray

    def pull(self, view: int) -> ImageArray:
        """Return how hard a view pulls every height down, (H, W)."""
        residual = self.values[view] - self.template
        force = self.weights[view] * self.lever[view] * self.slope * residual
        return np.asarray(force, np.float32)


def compare_views(
    height: FloatArray,
    known: BoolArray,
    samplers: Sequence[ViewSampler],
    parallax: FloatArray,
    normalizing_px: float,
) -> ComparedViews:
    """Resample all views at heights (H, W), and take out gain and offset over a window of `normalizing_px`."""
    values = np.empty((len(samplers), *height.shape), np.float32)
    slopes, weights = np.empty_like(values), np.empty_like(values)
    surface = known.astype(np.float32)
    for i, sampler in enumerate(samplers):
        value, slope, inside = sampler.sample(height)
        weight = inside * surface
        coverage = np.maximum(gaussian_window(weight, normalizing_px), 1e-3)
        mean = gaussian_window(value * weight, normalizing_px) / coverage
        centred = (value - mean) * weight
        # What the mean takes from the values it takes from their slope as well.
        slope -= gaussian_window(slope * weight, normalizing_px) / coverage
        deviation = np.sqrt(np.maximum(gaussian_window(centred * centred, normalizing_px) / coverage, 1e-6))
        values[i], slopes[i], weights[i] = centred / deviation, slope * weight / deviation, weight
    _weigh_by_agreement(values, weights, surface, normalizing_px)
    total = np.maximum(weights.sum(axis=0), 1e-3)
    g = parallax[:, None, None].astype(np.float32)
    lever = g - (g * weights).sum(axis=0) / total
    return ComparedViews(
        values,
        slopes,
        weights,
        total,
        template=(values * weights).sum(axis=0) / total,
        slope=(slopes * weights).sum(axis=0) / total,
        lever=lever,
        leverage=(weights * lever * lever).sum(axis=0),
    )


def _weigh_by_agreement(
    values: NDArray[np.float32], weights: NDArray[np.float32], surface: ImageArray, sigma_px: float
) -> None:
    """Lower in place the weight of a view where it does not correlate with the others: occluded, charged, moved."""
    total = np.maximum(weights.sum(axis=0), 1e-3)
    sum_of_all = (values * weights).sum(axis=0)
    start = weights.copy()
    for i in range(len(values)):
        others = (sum_of_all - values[i] * start[i]) / np.maximum(total - start[i], 1e-3)
        power = np.maximum(gaussian_window(others * others * surface, sigma_px), _LEAST_POWER)
        own = np.maximum(gaussian_window(values[i] * values[i] * surface, sigma_px), _LEAST_POWER)
        correlation = gaussian_window(values[i] * others * surface, sigma_px) / np.sqrt(power * own)
        weights[i] *= np.clip((correlation - _LEAST_CORRELATION) / (_FULL_CORRELATION - _LEAST_CORRELATION), 0, 1)
