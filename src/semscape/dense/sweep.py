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
from functools import partial
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.dense.consistency import compare_views
from semscape.dense.given import JUMP_PX, median_of, near_jumps, smoothed, without_spikes
from semscape.dense.posterior import lattice_table
from semscape.dense.sampling import ViewSampler, gaussian_window
from semscape.dense.semi_global import least_cost
from semscape.dense.side_by_side import Mapper
from semscape.dense.stereo import filled_from_nearest, without_speckles
from semscape.dense.sweep_cost import LARGEST_DIFFERENCE, fill_costs, window_taps
from semscape.types import BoolArray, FloatArray, ImageArray

_REACHES_PX = 20.0
_COARSE_STEP_PX, _FINE_STEP_PX = 1.0, 0.5
_REACH_PX = 9
_SPARE_PX = 3.0
_WINDOW_PX = 0.8
_SELECTION_WINDOW_PX = 1.5
_GAIN_WINDOW_PX = 12.0
# The pairs' disparity jumps, sharply or smeared, where over a square of so many px it spans so many px.
_JUMPS = ((3, 1.5), (13, 5.0))
_AROUND_PX = 9
# Beside a jump: how far blur and parallax carry its other side, and how much the brightness there counts.
_BESIDE_PX = 3
_BESIDE_SHARE = 0.05
_SPECK_PX = 5
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
# Rows whose costs are computed at a time.
_BAND_PX = 64


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
class _Labels:
    """Heights tried at every pixel: (first + k) step, k < count, `step_px` of disparity apart; `first` is (H, W)."""

    first: NDArray[np.int32]
    step: float
    step_px: float
    count: int


@dataclass(frozen=True)
class _Brightness:
    """Gain (V,) and offset image (V, H, W) that bring each view to the reference's brightness; `noise` is left."""

    gain: list[float]
    offset: NDArray[np.float32]
    noise: float


def sharpen_jumps(start: FloatArray, views: Views, *, mapper: Mapper = map) -> FloatArray:
    """Replace the heights that a depth jump has smeared, and add those that the views agree on.

    Only jumps, unknown places and their surroundings are swept.

    Parameters
    ----------
    start : (H, W) float array
        Heights of the pairs, in px, NaN where unknown; kept where nothing agrees better.
    views : Views
    mapper : callable
        `map`, or one that runs parts side by side; the result does not depend on it.
    """
    wanted = _near_jumps(start, views.baseline)
    if not np.isfinite(start).any() or not wanted.any():
        return start
    filled = median_of(filled_from_nearest(start))
    coarse = _labels(filled, _COARSE_STEP_PX, views.baseline)
    level = np.zeros(start.shape, np.int32)
    # At first brightness is compared over the whole field: beside a smeared jump the wrong places lie in any window.
    found = _sweep(coarse, wanted, level, views, _brightness(filled, views, None), mapper)
    surface = median_of(filled_from_nearest(np.where(wanted, found, start)))
    found = _sweep(coarse, wanted, level, views, _brightness(surface, views, _GAIN_WINDOW_PX), mapper)
    surface = _without_stairs(np.where(wanted, found, start), views.baseline)
    fine = _labels(filled, _FINE_STEP_PX, views.baseline)
    slopes = np.rint(surface / fine.step).astype(np.int32)
    apart = _apart_from_jumps(surface, views.baseline)
    found = _sweep(fine, wanted, slopes, views, _brightness(surface, views, _GAIN_WINDOW_PX, apart), mapper)
    return _better(start, found, views, mapper)


def _without_stairs(height: FloatArray, baseline: float) -> FloatArray:
    """Smooth heights that are whole steps; the pairs' own slopes lead up to a jump where the ground is flat."""
    given = without_spikes(filled_from_nearest(height), JUMP_PX / baseline)
    return smoothed(given, np.isfinite(height), baseline, lattice_table()).height


def _near_jumps(start: FloatArray, baseline: float) -> BoolArray:
    """Return where the pairs' disparity jumps or, in more than specks, is unknown, and around."""
    unknown = np.isnan(start).astype(np.uint8)
    holes = cv2.morphologyEx(unknown, cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))
    disparity = median_of(filled_from_nearest(start) * baseline)
    jump = np.zeros(start.shape, bool)
    for side, span in _JUMPS:
        square = np.ones((side, side), np.uint8)
        jump |= cv2.dilate(disparity, square) - cv2.erode(disparity, square) > span
    side = 2 * _AROUND_PX + 1
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    near: BoolArray = cv2.dilate(jump.astype(np.uint8) | holes, around) > 0
    return near


def _labels(height: FloatArray, step_px: float, baseline: float) -> _Labels:
    """Return labels `step_px` of disparity apart, laid across what each neighbourhood spans if that fits."""
    count, step = int(_REACHES_PX / step_px), step_px / baseline
    square = np.ones((2 * _REACH_PX + 1, 2 * _REACH_PX + 1), np.uint8)
    labels = (height / step).astype(np.float32)
    low, high = cv2.erode(labels, square), cv2.dilate(labels, square)
    middle = np.where(high - low < count - _SPARE_PX / step_px, (low + high) / 2, labels)
    return _Labels((np.rint(middle) - count // 2).astype(np.int32), step, step_px, count)


def _sweep(
    labels: _Labels,
    wanted: BoolArray,
    slopes: NDArray[np.int32],
    views: Views,
    brightness: _Brightness,
    mapper: Mapper,
) -> FloatArray:
    """Return the heights (H, W) of least cost, NaN where none is wanted or the least lies at the end of the range."""
    first, step = labels.first, labels.step
    unit = np.float32(1 / brightness.noise)
    order = [*views.others, views.reference]
    looks = [views.samplers[i] for i in order]
    images = np.stack(
        [
            np.where(look.mask > 0, look.image * np.float32(brightness.gain[i]) * unit, np.float32(np.nan))
            for i, look in zip(order, looks, strict=True)
        ]
    )
    side = np.where(views.parallax[views.others] < views.parallax[views.reference], -1, 1)
    around = cv2.dilate(wanted.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    given = (
        first,
        step,
        wanted,
        around,
        images,
        np.stack([look.view_from_grid for look in looks]),
        np.stack([look.px_per_height for look in looks]),
        brightness.offset[views.others] * unit,
        side,
        window_taps(_WINDOW_PX),
    )
    edges = [*range(0, len(first), _BAND_PX), len(first)]
    cost = np.concatenate(list(mapper(partial(_band, labels.count, given), pairwise(edges))))
    here = np.asarray((first + labels.count // 2) * step, np.float64)
    guide = views.samplers[views.reference].look(here)[0] * unit
    label = least_cost(cost, first, wanted, slopes, guide, _PENALTY_SMALL, _PENALTY_LARGE)
    return without_speckles(label * labels.step_px, _SPECKLE_AREA_PX) / labels.step_px * step


def _band(count: int, given: tuple[Any, ...], rows: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the costs of some rows, (last - first, W, count)."""
    cost = np.zeros((rows[1] - rows[0], given[0].shape[1], count), np.uint8)
    fill_costs(rows, cost, *given)
    return cost


def _apart_from_jumps(height: FloatArray, baseline: float) -> ImageArray:
    """Return how much pixels (H, W) count for brightness: little beside a jump, where some views show its other side.

    Else the whole window around sees the views differ as the jump does.
    """
    beside = near_jumps(height, JUMP_PX / baseline, _BESIDE_PX)
    return np.where(beside, np.float32(_BESIDE_SHARE), np.float32(1))


def _brightness(
    height: FloatArray, views: Views, window_px: float | None, share: ImageArray | None = None
) -> _Brightness:
    """Compare the views' brightness on a surface, each pixel by its share; the whole field's without a window."""
    looks = [sampler.look(height) for sampler in views.samplers]
    own, own_inside = looks[views.reference]
    gain, residuals = [1.0] * len(looks), []
    offset = np.zeros((len(looks), *height.shape), np.float32)
    for i in views.others:
        value, inside = looks[i]
        both = inside * own_inside
        seen = _sample(both > 0)
        if not seen[0].size:
            continue
        gain[i] = _scatter(own[seen]) / _scatter(value[seen])
        difference = value * np.float32(gain[i]) - own
        difference = np.clip(difference, *np.percentile(difference[seen], [2, 98]).astype(np.float32))
        if window_px is None:
            offset[i] = difference[seen].mean()
        else:
            weight = both if share is None else both * share
            total = np.maximum(gaussian_window(weight, window_px), 1e-3)
            offset[i] = gaussian_window((difference * weight).astype(np.float32), window_px) / total
        residuals.append(np.abs(difference - offset[i])[seen])
    noise = 1.4826 * float(np.median(np.concatenate(residuals))) if residuals else 1.0
    return _Brightness(gain, offset, max(noise, 1e-6))


def _sample(where: BoolArray) -> tuple[NDArray[np.int64], ...]:
    """Return row and column of every ninth pixel of those asked for: enough for a median."""
    rows, cols = np.nonzero(where[::3, ::3])
    return 3 * rows, 3 * cols


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
        cut = np.minimum(difference / np.float32(brightness.noise), np.float32(LARGEST_DIFFERENCE))
        found[i] = gaussian_window(
            np.where(inside * own_inside > 0, cut, np.float32(LARGEST_DIFFERENCE / 2)), window_px
        )
    return found


def _better(refined: FloatArray, swept: FloatArray, views: Views, mapper: Mapper) -> FloatArray:
    """Take the swept height where the better half of the views agree on it more than on the refined one."""
    misfits, noises = zip(*mapper(partial(_misfit, views), (refined, swept)), strict=True)
    noise = min(noises)
    least_gain = _LEAST_GAIN / np.sqrt((len(views.others) + 1) // 2)
    known, found = np.isfinite(refined), np.isfinite(swept)
    with np.errstate(invalid="ignore"):
        moved = np.abs(refined - swept) * views.baseline > _LEAST_CHANGE_PX
    replaced = known & found & moved & (misfits[1] < misfits[0] - least_gain * noise)
    replaced |= ~known & found & (misfits[1] < _AGREED * noise)
    sharp = np.where(replaced, swept, refined)
    # Where nothing has texture the views differ by noise alone whatever the height: they must correlate, too.
    filled, given = filled_from_nearest(sharp), np.isfinite(sharp)
    seen = compare_views(filled, given, views.samplers, views.parallax, _AGREEMENT_PX, mapper=mapper)
    replaced &= (seen.weights > 0.5).sum(axis=0) >= 2
    return np.where(replaced, swept, refined)


def _misfit(views: Views, height: FloatArray) -> tuple[FloatArray, float]:
    """Return how far the better half of the views differs from the reference (H, W), and the noise in that."""
    filled = filled_from_nearest(height)
    brightness = _brightness(filled, views, _GAIN_WINDOW_PX)
    ranked = np.sort(list(_differences(filled, views, brightness, _SELECTION_WINDOW_PX).values()), axis=0)
    return ranked[: (len(ranked) + 1) // 2].mean(axis=0) * brightness.noise, brightness.noise
