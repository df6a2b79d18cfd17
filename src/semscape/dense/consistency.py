"""How far the views agree on a height map: every view resampled at its heights, up to gain and offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from semscape.dense.sampling import ViewSampler, gaussian_window
from semscape.dense.side_by_side import Mapper
from semscape.types import BoolArray, FloatArray, ImageArray

_LEAST_CORRELATION = 0.3
_FULL_CORRELATION = 0.7
# Values are normalized: a window that holds less than this of their power is empty but for the rim of some texture.
_LEAST_POWER = 0.05

Stack = NDArray[np.float32]
# Grey values, their slope along the parallax, and validity, (H, W) each.
Look = tuple[ImageArray, ImageArray, ImageArray]


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
    *,
    mapper: Mapper = map,
) -> ComparedViews:
    """Resample all views at heights (H, W), and take out gain and offset over a window of `normalizing_px`."""
    looks = list(mapper(partial(look_through, height), samplers))
    return compare_looks(looks, known, parallax, normalizing_px, mapper=mapper)


def look_through(height: FloatArray, sampler: ViewSampler) -> Look:
    """Return what a view shows at heights (H, W): grey values, their slope along the parallax, validity."""
    return sampler.sample(height)


def compare_looks(
    looks: Sequence[Look], known: BoolArray, parallax: FloatArray, normalizing_px: float, *, mapper: Mapper = map
) -> ComparedViews:
    """Compare what views show at one height map, less gain and offset over a window of `normalizing_px`."""
    surface = known.astype(np.float32)
    planes = mapper(partial(_normalized, surface, normalizing_px), looks)
    values, slopes, inside = (np.stack(kind) for kind in zip(*planes, strict=True))
    total = np.maximum(inside.sum(axis=0), 1e-3)
    sum_of_all = (values * inside).sum(axis=0)
    weights = np.stack(list(mapper(partial(_agreeing, sum_of_all, total, surface, normalizing_px), values, inside)))
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


def _normalized(surface: ImageArray, normalizing_px: float, look: Look) -> tuple[ImageArray, ImageArray, ImageArray]:
    """Return values and slopes of a view, less its own gain and offset, and where it shows the surface, (H, W)."""
    value, slope, inside = look
    weight: ImageArray = inside * surface
    coverage = np.maximum(gaussian_window(weight, normalizing_px), 1e-3)
    mean = gaussian_window(value * weight, normalizing_px) / coverage
    centred = np.asarray((value - mean) * weight, np.float32)
    # What the mean takes from the values it takes from their slope as well.
    level = slope - gaussian_window(slope * weight, normalizing_px) / coverage
    deviation = np.sqrt(np.maximum(gaussian_window(centred * centred, normalizing_px) / coverage, 1e-6))
    values, slopes = np.asarray(centred / deviation, np.float32), np.asarray(level * weight / deviation, np.float32)
    return values, slopes, weight


def _agreeing(
    sum_of_all: ImageArray,
    total: ImageArray,
    surface: ImageArray,
    sigma_px: float,
    values: ImageArray,
    weight: ImageArray,
) -> ImageArray:
    """Return a view's weight, lowered where it does not correlate with the others: occluded, charged, moved."""
    others = (sum_of_all - values * weight) / np.maximum(total - weight, 1e-3)
    power = np.maximum(gaussian_window(others * others * surface, sigma_px), _LEAST_POWER)
    own = np.maximum(gaussian_window(values * values * surface, sigma_px), _LEAST_POWER)
    correlation = gaussian_window(values * others * surface, sigma_px) / np.sqrt(power * own)
    agreement = np.clip((correlation - _LEAST_CORRELATION) / (_FULL_CORRELATION - _LEAST_CORRELATION), 0, 1)
    return np.asarray(weight * agreement, np.float32)
