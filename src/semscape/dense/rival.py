"""The rivals: OpenCV's StereoSGBM and DIS flow on the widest pair, rectified and triangulated with our own cameras.

They get everything but the matching for free: our calibration, our rectified frame and the range of our sparse
heights. So the difference to ours is that of the dense stage alone: all views, fusion and refinement against one pair.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.dense.fuse import to_zero_tilt
from semscape.dense.rectify import Frame, rectified_frame, warp_to_frame
from semscape.dense.stereo import consistent
from semscape.dense.surface import choose_pairs, height_range_px, resample
from semscape.types import BoolArray, FloatArray, HeightMap, ImageArray, Result

_BLOCK_PX = 7
_MARGIN_PX = 4
_SUBPIXEL_STEPS = 16
_ROUND_TRIP_PX = 1.0


def sgbm_height_map(result: Result) -> HeightMap:
    """Return the height map that StereoSGBM (mode HH, block 7) makes from two views of a result.

    The pair is the widest up to 30 deg, as in our own dense stage; between views that differ more, no block matches.

    Parameters
    ----------
    result : Result
        Its calibration, frame and grid are used.

    Returns
    -------
    HeightMap
        Over the grid of the result's height map, without uncertainties.

    References
    ----------
    H. Hirschmüller, "Stereo processing by semiglobal matching and mutual information", IEEE TPAMI 30 (2008),
    doi:10.1109/TPAMI.2007.1166.
    """
    frame, first, last, warped, images = _widest_pair(result)
    baseline = float(frame.parallax[last] - frame.parallax[first])

    # A height h is seen at u + h g, so OpenCV's disparity u1 - u2 is -h baseline; the baseline has a sign.
    # A wider range than that of the sparse points costs it time and makes it err more.
    heights = height_range_px(result.reconstruction, frame, beyond_points=False)
    low, high = sorted(height * baseline for height in heights)
    least = int(np.floor(-high)) - _MARGIN_PX
    count = int(np.ceil((high - low + 2 * _MARGIN_PX) / _SUBPIXEL_STEPS)) * _SUBPIXEL_STEPS
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=_BLOCK_PX,
        P1=8 * _BLOCK_PX**2,
        P2=32 * _BLOCK_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    disparity = matcher.compute(*images).astype(np.float64) / _SUBPIXEL_STEPS
    disparity[(disparity < least) | ~warped[0][1]] = np.nan
    return _triangulated(-disparity, result, frame, first, baseline)


def dis_height_map(result: Result) -> HeightMap:
    """Return the height map that DIS optical flow (medium preset) makes from the same two views of a result.

    Heights are the flow along the rows; where the flow there and back differ by more than 1 px they are unknown.

    References
    ----------
    T. Kroeger et al., "Fast optical flow using dense inverse search", ECCV 2016, doi:10.1007/978-3-319-46493-0_29.
    """
    frame, first, last, warped, images = _widest_pair(result)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there, back = (flow.calc(one, other, None)[..., 0].astype(np.float64) for one, other in (images, images[::-1]))
    known = np.isfinite(consistent(there, back, _ROUND_TRIP_PX)) & warped[0][1]
    baseline = float(frame.parallax[last] - frame.parallax[first])
    return _triangulated(np.where(known, there, np.nan), result, frame, first, baseline)


def _widest_pair(
    result: Result,
) -> tuple[Frame, int, int, list[tuple[ImageArray, BoolArray]], list[NDArray[np.uint8]]]:
    series, reconstruction = result.series, result.reconstruction
    frame = rectified_frame(series, reconstruction)
    ((first, last),) = choose_pairs(reconstruction.motion.tilt_rad, 1)
    warped = [warp_to_frame(series.views[i], i, reconstruction.motion, frame) for i in (first, last)]
    return frame, first, last, warped, [_to_bytes(image, valid) for image, valid in warped]


def _triangulated(disparity: FloatArray, result: Result, frame: Frame, first: int, baseline: float) -> HeightMap:
    at_zero_tilt = to_zero_tilt(disparity / baseline, float(frame.parallax[first]))
    ours = result.height_map
    height = resample(at_zero_tilt, frame, ours.world_from_grid, result.series.shape) * frame.pixel_size_um
    return replace(ours, height_um=height, uncertainty_um=np.full(height.shape, np.nan))


def _to_bytes(image: ImageArray, valid: BoolArray) -> NDArray[np.uint8]:
    """Return an image as uint8, its range stretched where it is wider or narrower than eight bits."""
    low, high = float(image[valid].min()), float(image[valid].max())
    if low < 0 or high > 255 or high < 64:
        low, high = np.percentile(image[valid], [0.1, 99.9])
        image = (image - low) * (255 / (high - low))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
