"""Sub-pixel places of keypoints that a detector gives to whole pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.types import BoolArray, FloatArray

# From the highest of the 3 x 3 pixels; what the quadratic says beyond that is not known to be a peak.
_FARTHEST_PX = 1.0


def nearest_peak(
    image: NDArray[np.uint8], pixel: NDArray[np.int64], sigma_px: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Move pixels to the peak of the Laplacian of Gaussian beside them.

    Of the two ways, to a bright or to a dark blob, it goes the one that the sign at the pixel tells: at most one
    pixel uphill in x and y, then to the top of the quadratic through 3 x 3 pixels.

    Parameters
    ----------
    image : (H, W) uint8 array
        Grey levels.
    pixel : (N, 2) int array
        Column and row, at least 2 px from the border.
    sigma_px : float
        Of the Gaussian; a blob of this sigma responds most.

    Returns
    -------
    xy : (N, 2) float array
        In px.
    height : (N,) float array
        Response at the peak, in grey levels of a blob that fits `sigma_px`; negative for a dark one.
    is_peak : (N,) bool array
        False where there is none within a pixel: there `xy` is the pixel itself.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(32.0), np.arange(32.0))
    >>> image = 100 + 80 * np.exp(-((x - 15.3) ** 2 + (y - 16.4) ** 2) / 8)
    >>> xy, height, is_peak = nearest_peak(np.rint(image).astype(np.uint8), np.array([[15, 16]]), 2.0)
    >>> xy.round(1).tolist(), height.round(-1).tolist(), is_peak.tolist()
    ([[15.3, 16.4]], [80.0], [True])
    """
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px)
    response = np.asarray(cv2.Laplacian(smooth, cv2.CV_32F, ksize=1))
    # A blob A exp(-r^2 / 2 sigma^2) smoothed by its own sigma has the Laplacian -A / (2 sigma^2) at its centre.
    response *= np.float32(-2 * sigma_px**2)
    x, y = pixel[:, 0], pixel[:, 1]
    sign = np.where(response[y, x] < 0, -1.0, 1.0)
    patch = sign[:, None] * _around(response, x, y)
    uphill = patch.argmax(axis=1)
    x, y = x + uphill % 3 - 1, y + uphill // 3 - 1
    patch = sign[:, None] * _around(response, x, y)
    step, gain = _top_of_quadratic(patch)
    is_peak = np.abs(step).max(axis=1, initial=0.0) <= _FARTHEST_PX
    xy = np.where(is_peak[:, None], np.column_stack([x, y]) + step, pixel)
    return xy, sign * (patch[:, 4] + np.where(is_peak, gain, 0.0)), is_peak


def _around(response: NDArray[np.float32], x: NDArray[np.int64], y: NDArray[np.int64]) -> FloatArray:
    """Return the 3 x 3 values about each pixel as (N, 9), row by row."""
    values = [response[y + row, x + col] for row in (-1, 0, 1) for col in (-1, 0, 1)]
    return np.stack(values, axis=1).astype(np.float64)


def _top_of_quadratic(patch: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the way (N, 2) from the centre to the top of the quadratic through (N, 9) values, and the gain (N,)."""
    nw, n, ne, w, centre, e, sw, s, se = patch.T
    gx, gy = (e - w) / 2, (s - n) / 2
    xx, yy, xy = e + w - 2 * centre, s + n - 2 * centre, (se + nw - sw - ne) / 4
    determinant = xx * yy - xy * xy
    peaked = (xx < 0) & (determinant > 0)
    divisor = np.where(peaked, determinant, 1.0)
    step = np.column_stack([xy * gy - yy * gx, xy * gx - xx * gy]) / divisor[:, None]
    gain = (gx * step[:, 0] + gy * step[:, 1]) / 2
    step[~peaked] = np.inf
    return step, gain
