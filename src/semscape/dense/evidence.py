"""The last step: the most probable surface under all views, its smoothness by evidence, its uncertainty.

Beside depth jumps the views' windows hold two surfaces; there the heights of the sweep are the data. Everywhere else
each pixel's pull counts by its noise, and by how much the views' pulls scatter together over as many pixels as the
surface is averaged over: drift and jitter of the scan make neighbours err alike, the more the wider the window.
"""

from __future__ import annotations

import cv2
import numpy as np

from semscape.dense.consistency import ComparedViews, compare_views
from semscape.dense.posterior import (
    DataTerm,
    LatticeTable,
    Smoothness,
    averaging_width,
    height_variance,
    most_probable,
    smoothness_by_evidence,
    smoothness_cut,
)
from semscape.dense.refine import RefinedHeights
from semscape.dense.sampling import gaussian_window
from semscape.dense.stereo import filled_from_nearest
from semscape.dense.sweep import Views
from semscape.types import BoolArray, FloatArray

_ROUNDS = 7
_NORMALIZING_PX = 4.0
_NOISE_PX = 6.0
# Windows in which the scatter of the views' pulls is compared with that of independent pixels.
_WIDTHS_PX = (1.5, 3.0, 6.0, 12.0)
_JUMP_PX = 1.0
_SPIKE_PX = 5
_MAX_STEP_PX = 0.5
_START_TAU = 0.5
# Beside a jump: how far, the noise of the sweep's disparity, and over how many pixels it errs alike.
_BESIDE_PX = 6
_SWEEP_NOISE_PX = 0.6
_SWEEP_CORRELATED = 10.0
# With two views nothing tells how their pulls scatter.
_PAIR_INFLATION = 4.0


def refine_by_evidence(start: RefinedHeights, views: Views) -> RefinedHeights:
    """Return the most probable heights near the given ones, in px, with their 1-sigma uncertainty.

    Parameters
    ----------
    start : RefinedHeights
        In px, crisp at jumps; unknown heights stay unknown.
    views : Views

    References
    ----------
    MacKay 1992, doi:10.1162/neco.1992.4.3.415.
    """
    known = np.isfinite(start.height)
    if not known.any():
        return start
    base = views.baseline
    first = _without_spikes(filled_from_nearest(start.height), _JUMP_PX / base)
    given = np.where(known, first, np.nan)
    cut = smoothness_cut(given, _JUMP_PX / base)
    beside = _beside_jumps(given, _JUMP_PX / base)
    held = (base / _SWEEP_NOISE_PX) ** 2 / _SWEEP_CORRELATED
    table = LatticeTable()
    prior = Smoothness(np.full(first.shape, _START_TAU**2), np.ones(first.shape))
    width = np.full(first.shape, 3.0)
    height = first
    for _ in range(_ROUNDS):
        seen = compare_views(height, known, views.samplers, views.parallax, _NORMALIZING_PX)
        noise, inflation, slow = _noise(seen, known)
        divisor = noise * np.exp(np.interp(np.log(width), np.log(_WIDTHS_PX), np.log(inflation)))
        free_stiffness = seen.slope**2 * seen.leverage / divisor
        stiffness = known * np.where(beside, held, free_stiffness)
        pull = -sum(seen.pull(i) for i in range(len(views.samplers))) / divisor
        data = DataTerm(stiffness, known * np.where(beside, held * (first - height), pull))
        moved = most_probable(height, data, cut, prior)
        height = np.clip(moved, height - _MAX_STEP_PX / base, height + _MAX_STEP_PX / base)
        prior = smoothness_by_evidence(height, stiffness, cut, prior, table)
        width = np.clip(averaging_width(stiffness, known, prior, table), _WIDTHS_PX[0], _WIDTHS_PX[-1])
    variance = height_variance(stiffness, known, prior, table)
    variance = np.where(beside, np.maximum(variance, (_SWEEP_NOISE_PX / base) ** 2), variance + slow)
    return RefinedHeights(np.where(known, height, np.nan), np.where(known, np.sqrt(variance), np.nan), start.n_views)


def _noise(seen: ComparedViews, known: BoolArray) -> tuple[FloatArray, list[float], float]:
    """Return what the views say about their noise.

    The variance (H, W) of one pixel's grey value; how many times more the views' pulls scatter, in each of the
    windows, than independent pixels do; and the variance of a height, px^2, that their slow errors make, which no
    smoothing lowers.
    """
    count = len(seen.values)
    residual = seen.weights * (seen.values - seen.template) ** 2
    noise = gaussian_window(residual.sum(axis=0) / np.maximum(seen.total - 1, 0.25), _NOISE_PX)
    noise = np.maximum(noise, np.float32(1e-3))
    stiffness = seen.slope**2 * seen.leverage
    if count == 2:
        return noise.astype(np.float64), [_PAIR_INFLATION] * len(_WIDTHS_PX), 0.0
    pulls = [seen.pull(i) for i in range(count)]
    inflation = []
    for width in _WIDTHS_PX:
        squares = np.stack([gaussian_window(pull, width)[known] ** 2 for pull in pulls])
        scatter = squares.sum(axis=0) * count / (count - 2)
        alone = gaussian_window(noise * stiffness, width / np.sqrt(2.0))[known] / (4 * np.pi * width**2)
        inflation.append(max(float(np.median(scatter / np.maximum(alone, 1e-12))), 1.0))
    slow = scatter / np.maximum(gaussian_window(stiffness, _WIDTHS_PX[-1])[known], 1e-9) ** 2
    return noise.astype(np.float64), inflation, float(np.median(slow))


def _without_spikes(height: FloatArray, limit: float) -> FloatArray:
    """Replace what stands out of its 5 x 5 px by more than `limit`: narrower than the beam and so no shape."""
    median = np.asarray(cv2.medianBlur(height.astype(np.float32), _SPIKE_PX), np.float64)
    return np.where(np.abs(height - median) > limit, median, height)


def _beside_jumps(height: FloatArray, limit: float) -> BoolArray:
    """Return where a step beyond `limit` lies within 6 px."""
    jump = np.zeros(height.shape, np.uint8)
    with np.errstate(invalid="ignore"):
        along = np.abs(np.diff(height, axis=1)) > limit
        down = np.abs(np.diff(height, axis=0)) > limit
    jump[:, 1:] |= along
    jump[:, :-1] |= along
    jump[1:] |= down
    jump[:-1] |= down
    side = 2 * _BESIDE_PX + 1
    beside: BoolArray = cv2.dilate(jump, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
    return beside
