"""Crisp depth jumps: a sweep of heights through all views, in the reference grid.

The windows of pair matching and of refinement hold two surfaces at a depth jump and smear it. Here the views are
compared with the reference view at every pixel and height through a window of about a pixel, which is enough
because all views speak at once; semi-global regularization does the rest. Beside a jump the ground may be hidden
from the views on one side: there those on the other side decide. A last sweep follows the slopes that the earlier
ones found, so that slopes become no stairs. Where the views agree on the sweep's height more than on the refined
one, by more than chance, it replaces that.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from semscape.dense.consistency import compare_views
from semscape.dense.sampling import ViewSampler, gaussian_window
from semscape.dense.semi_global import least_cost
from semscape.dense.stereo import filled_from_nearest, without_speckles
from semscape.types import BoolArray, FloatArray, ImageArray

_STEP_PX = 0.5
_LABELS = 40
_REACH_PX = 9
_WINDOW_PX = 0.8
_SELECTION_WINDOW_PX = 1.5
_GAIN_WINDOW_PX = 12.0
# A difference between views is cut off at so many sigmas of noise; costs are counted in twentieths of a sigma.
_LARGEST_DIFFERENCE = 3.0
_COST_UNIT = 20.0
# One side's views must agree better than all by this to be believed alone: they are fewer.
_ONE_SIDED = 0.4
_PENALTY_SMALL = 12.0
_PENALTY_LARGE = 120.0
# Of one view; of n views' mean a difference by chance is sqrt(n) smaller.
_LEAST_GAIN = 0.21
_LEAST_CHANGE_PX = 0.5
# Where nothing was known before, no more difference than noise makes is asked for.
_AGREED = 1.0
_AGREEMENT_PX = 2.5
# Smaller patches that stand alone in a sweep are chance agreements of noise.
_SPECKLE_AREA_PX = 60


@dataclass(frozen=True)
class Views:
    """What a sweep needs of all views: how to look through them, their parallax (V,), and which is the reference."""

    samplers: tuple[ViewSampler, ...]
    parallax: FloatArray
    reference: int

    @property
    def others(self) -> list[int]:
        """Indices of all views but the reference."""
        return [i for i in range(len(self.samplers)) if i != self.reference]

    @property
    def baseline(self) -> float:
        """Parallax between the extreme views, px of image per px of height."""
        return float(np.ptp(self.parallax))


@dataclass(frozen=True)
class _Brightness:
    """Gain (V,) and offset image (V, H, W) that bring each view to the reference's brightness; `noise` is left."""

    gain: list[float]
    offset: NDArray[np.float32]
    noise: float


@dataclass(frozen=True)
class Sharpened:
    """Heights (H, W) px, where they are not those given, and how many views agree on the new ones."""

    height: FloatArray
    replaced: BoolArray
    n_views: NDArray[np.uint8]


def sharpen_jumps(start: FloatArray, refined: FloatArray, views: Views) -> Sharpened:
    """Replace the heights that a depth jump has smeared, and add those that the views agree on.

    Parameters
    ----------
    start : (H, W) float array
        Heights of the pairs, in px, NaN where unknown; they tell the range to sweep.
    refined : (H, W) float array
        Heights to be kept where nothing agrees better; NaN where unknown.
    views : Views
    """
    if not np.isfinite(start).any():
        return Sharpened(refined, np.zeros(refined.shape, bool), np.zeros(refined.shape, np.uint8))
    step = _STEP_PX / views.baseline
    filled = _median(filled_from_nearest(start))
    first = _first_label(filled, step)
    level = np.zeros(first.shape, np.int32)
    # At first brightness is compared over the whole field: beside a smeared jump the wrong places lie in any window.
    found = _sweep(first, step, level, views, _brightness(filled, views, None))
    surface = _median(filled_from_nearest(found))
    found = _sweep(first, step, level, views, _brightness(surface, views, _GAIN_WINDOW_PX))
    prior = filled_from_nearest(_better(refined, found, views).height)
    slopes = np.rint(prior / step).astype(np.int32)
    found = _sweep(first, step, slopes, views, _brightness(prior, views, _GAIN_WINDOW_PX))
    return _better(refined, found, views)


def _first_label(height: FloatArray, step: float) -> NDArray[np.int32]:
    """Return the lowest label of every pixel's range, laid across what its neighbourhood spans where that fits."""
    low = minimum_filter(height, 2 * _REACH_PX + 1) / step
    high = maximum_filter(height, 2 * _REACH_PX + 1) / step
    middle = np.where(high - low < _LABELS - 6, (low + high) / 2, height / step)
    first: NDArray[np.int32] = (np.rint(middle) - _LABELS // 2).astype(np.int32)
    return first


def _sweep(
    first: NDArray[np.int32], step: float, slopes: NDArray[np.int32], views: Views, brightness: _Brightness
) -> FloatArray:
    cost = np.empty((*first.shape, _LABELS), np.uint8)
    for k in range(_LABELS):
        differences = _differences(np.asarray((first + k) * step, np.float64), views, brightness, _WINDOW_PX)
        agreed = np.mean(list(differences.values()), axis=0)
        for side in (-1, 1):
            one_side = [
                differences[i] for i in differences if side * (views.parallax[i] - views.parallax[views.reference]) > 0
            ]
            if one_side and len(one_side) < len(differences):
                agreed = np.minimum(agreed, np.mean(one_side, axis=0) + np.float32(_ONE_SIDED))
        cost[:, :, k] = np.rint(agreed * _COST_UNIT)
    here = np.asarray((first + _LABELS // 2) * step, np.float64)
    guide = views.samplers[views.reference].look(here)[0] / np.float32(brightness.noise)
    valid = np.ones(first.shape, bool)
    label = least_cost(cost, first, valid, slopes, guide, _PENALTY_SMALL, _PENALTY_LARGE)
    return without_speckles(label * _STEP_PX, _SPECKLE_AREA_PX) / _STEP_PX * step


def _brightness(height: FloatArray, views: Views, window_px: float | None) -> _Brightness:
    """Compare the views' brightness on a surface; over the whole field where `window_px` is None."""
    looks = [sampler.look(height) for sampler in views.samplers]
    own, own_inside = looks[views.reference]
    gain, residuals = [1.0] * len(looks), []
    offset = np.zeros((len(looks), *height.shape), np.float32)
    for i in views.others:
        value, inside = looks[i]
        both = inside * own_inside
        seen = both > 0
        if not seen.any():
            continue
        gain[i] = _scatter(own[seen]) / _scatter(value[seen])
        difference = value * np.float32(gain[i]) - own
        difference = np.clip(difference, *np.percentile(difference[seen], [2, 98]))
        if window_px is None:
            offset[i] = difference[seen].mean()
        else:
            share = np.maximum(gaussian_window(both, window_px), 1e-3)
            offset[i] = gaussian_window((difference * both).astype(np.float32), window_px) / share
        residuals.append(np.abs(difference - offset[i])[seen])
    noise = 1.4826 * float(np.median(np.concatenate(residuals))) if residuals else 1.0
    return _Brightness(gain, offset, max(noise, 1e-6))


def _scatter(values: ImageArray) -> float:
    return max(float(np.median(np.abs(values - np.median(values)))), 1e-6)


def _differences(
    height: FloatArray, views: Views, brightness: _Brightness, window_px: float
) -> dict[int, NDArray[np.float32]]:
    """Return each view's mean absolute difference to the reference around every pixel, in units of the noise."""
    own, own_inside = views.samplers[views.reference].look(height)
    found = {}
    for i in views.others:
        value, inside = views.samplers[i].look(height)
        difference = np.abs(value * np.float32(brightness.gain[i]) - brightness.offset[i] - own)
        cut = np.minimum(difference / np.float32(brightness.noise), np.float32(_LARGEST_DIFFERENCE))
        found[i] = gaussian_window(
            np.where(inside * own_inside > 0, cut, np.float32(_LARGEST_DIFFERENCE / 2)), window_px
        )
    return found


def _better(refined: FloatArray, swept: FloatArray, views: Views) -> Sharpened:
    """Take the swept height where the better half of the views agree on it more than on the refined one."""
    misfits, noises = [], []
    for height in (refined, swept):
        filled = filled_from_nearest(height)
        brightness = _brightness(filled, views, _GAIN_WINDOW_PX)
        ranked = np.sort(list(_differences(filled, views, brightness, _SELECTION_WINDOW_PX).values()), axis=0)
        misfits.append(ranked[: (len(ranked) + 1) // 2].mean(axis=0) * brightness.noise)
        noises.append(brightness.noise)
    noise = min(noises)
    least_gain = _LEAST_GAIN / np.sqrt((len(views.others) + 1) // 2)
    known, found = np.isfinite(refined), np.isfinite(swept)
    with np.errstate(invalid="ignore"):
        moved = np.abs(refined - swept) * views.baseline > _LEAST_CHANGE_PX
    replaced = known & found & moved & (misfits[1] < misfits[0] - least_gain * noise)
    replaced |= ~known & found & (misfits[1] < _AGREED * noise)
    sharp = np.where(replaced, swept, refined)
    # Where nothing has texture the views differ by noise alone whatever the height: they must correlate, too.
    seen = compare_views(filled_from_nearest(sharp), np.isfinite(sharp), views.samplers, views.parallax, _AGREEMENT_PX)
    n_views = (seen.weights > 0.5).sum(axis=0).astype(np.uint8)
    replaced &= n_views >= 2
    return Sharpened(np.where(replaced, swept, refined), replaced, np.where(replaced, n_views, 0).astype(np.uint8))


def _median(height: FloatArray) -> FloatArray:
    return np.asarray(cv2.medianBlur(height.astype(np.float32), 5), np.float64)
