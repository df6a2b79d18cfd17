"""Dense heights from one pair of rectified views, coarse to fine, checked left against right."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.dense.semi_global import census, match_rows
from semscape.options import DenseOptions
from semscape.types import BoolArray, FloatArray, ImageArray

_FINE_DISPARITIES = 16
_MAX_COARSE_DISPARITIES = 48
_COARSEST_SIDE_PX = 160
_RANGE_MARGIN_PX = 6
_SPECKLE_AREA_PX = 60
_FALLBACK_LEVELS = 2


@dataclass(frozen=True)
class RectifiedView:
    """A view in the rectified frame: `image` (H, W) float32, `valid` (H, W), and its parallax g."""

    image: ImageArray
    valid: BoolArray
    parallax: float


def pair_heights(
    view1: RectifiedView, view2: RectifiedView, height_range_px: tuple[float, float], options: DenseOptions
) -> FloatArray:
    """Return the height (H, W) in frame px seen at each pixel of view 1, NaN where unknown.

    Parameters
    ----------
    view1, view2 : RectifiedView
        Views of one frame; a point of height h is seen at u + h parallax.
    height_range_px : (float, float)
        Least and largest height expected, in frame px.
    options : DenseOptions
        Census window, penalties and the left-right limit.
    """
    baseline = view2.parallax - view1.parallax
    ends = sorted(baseline * height for height in height_range_px)
    low, high = ends[0] - _RANGE_MARGIN_PX, ends[1] + _RANGE_MARGIN_PX
    pyramid1, pyramid2 = _pyramid(view1, high - low), _pyramid(view2, high - low)
    forward: FloatArray | None = None
    levels: list[FloatArray] = []
    for level in range(len(pyramid1) - 1, -1, -1):
        (image1, valid1), (image2, valid2) = pyramid1[level], pyramid2[level]
        scale = 2.0**level
        census1, census2 = census(image1, options.census_radius_px), census(image2, options.census_radius_px)
        if forward is None:
            n = int(np.ceil((high - low) / scale)) + 3
            start = np.full(image1.shape, int(np.floor(low / scale)) - 1, np.int32)
        else:
            n = _FINE_DISPARITIES
            start = _finer_start(forward, n)
        small, large = options.penalty_small, options.penalty_large
        there, back = match_rows(census1, valid1, census2, valid2, start, n, small, large)
        forward = consistent(there, back, options.left_right_limit_px)
        levels.append(forward)
    return without_speckles(_finest_known(levels), _SPECKLE_AREA_PX) / baseline


def _finest_known(levels: list[FloatArray]) -> FloatArray:
    """Take each pixel's disparity from the finest level that passed the left-right check there.

    Where noise hides the fine texture, a coarser level still averages enough of it.
    """
    disparity = levels[-1].copy()
    for steps_up, coarse in enumerate(levels[-2 : -2 - _FALLBACK_LEVELS : -1], start=1):
        factor = 2**steps_up
        enlarged = factor * np.repeat(np.repeat(coarse, factor, axis=0), factor, axis=1)
        disparity = np.where(np.isfinite(disparity), disparity, enlarged)
    return disparity


def consistent(disparity1: FloatArray, disparity2: FloatArray, limit_px: float) -> FloatArray:
    """Keep of disparity1 (H, W) what disparity2 confirms from the other side within `limit_px`; NaN elsewhere."""
    known = np.isfinite(disparity1)
    columns = np.arange(disparity1.shape[1]) + np.where(known, disparity1, 0)
    target = np.rint(columns).astype(np.int64)
    inside = known & (target >= 0) & (target < disparity1.shape[1])
    back = np.take_along_axis(disparity2, np.clip(target, 0, disparity1.shape[1] - 1), axis=1)
    agrees = inside & (np.abs(disparity1 + back) <= limit_px)
    return np.where(agrees, disparity1, np.nan)


def without_speckles(disparity: FloatArray, area_px: int) -> FloatArray:
    """Drop patches of fewer than `area_px` pixels that a disparity step of more than 1 px cuts off."""
    steps = np.where(np.isfinite(disparity), np.rint(np.nan_to_num(disparity) * 8), -30000).astype(np.int16)
    cv2.filterSpeckles(steps, -30000, area_px, 8)
    return np.where(steps == -30000, np.nan, disparity)


def filled_from_nearest(values: FloatArray) -> FloatArray:
    """Return (H, W) values with every NaN replaced by the nearest known value; 0 where none is known."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros_like(values)
    if known.all():
        return values
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    value_of = np.empty(int(nearest.max()) + 1)
    value_of[nearest[known]] = values[known]
    filled: FloatArray = value_of[nearest]
    return filled


def _pyramid(view: RectifiedView, range_px: float) -> list[tuple[ImageArray, BoolArray]]:
    """Halve the view until the whole disparity range is short or the image small."""
    levels = [(np.ascontiguousarray(view.image), np.ascontiguousarray(view.valid))]
    while (
        range_px / 2.0 ** (len(levels) - 1) > _FINE_DISPARITIES and min(levels[-1][0].shape) // 2 >= _COARSEST_SIDE_PX
    ) or range_px / 2.0 ** (len(levels) - 1) > 4 * _MAX_COARSE_DISPARITIES:
        image, valid = levels[-1]
        size = (image.shape[1] // 2, image.shape[0] // 2)
        half = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        half_valid = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        levels.append((half, half_valid))
    return levels


def _finer_start(coarse: FloatArray, n_disparities: int) -> NDArray[np.int32]:
    """Return the start of the search range on the next finer level around the coarser level's disparities.

    Where the neighbourhood spans a depth jump that still fits the range, the range is laid across it, so that
    fine structures beside the jump are not lost; unknown pixels take the nearest known value.
    """
    filled = cv2.medianBlur(filled_from_nearest(coarse).astype(np.float32), 5)
    square = np.ones((5, 5), np.uint8)
    low, high = cv2.erode(filled, square), cv2.dilate(filled, square)
    fits = 2 * (high - low) < n_disparities - 6
    middle = np.where(fits, (low + high) / 2, filled)
    fine = np.repeat(np.repeat(2 * middle, 2, axis=0), 2, axis=1)
    start: NDArray[np.int32] = (np.rint(fine) - n_disparities // 2).astype(np.int32)
    return start
