"""Grey levels before detection: local mean and contrast made the same everywhere."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.types import BoolArray, ImageArray

# Local statistics are smooth: they are taken at a resolution at which their window still spans this many px.
_LEAST_COARSE_SIGMA_PX = 4.0
_MEAN, _DEVIATION = 128.0, 40.0


def normalize_contrast(image: ImageArray, mask: BoolArray, sigma_px: float) -> NDArray[np.uint8]:
    """Return the image (H, W) with local mean 128 and local standard deviation 40, as uint8.

    Local means are Gaussian, of `sigma_px`, over the pixels where `mask` is True. The local deviation is
    floored at a fifth of its median so that empty background does not turn into amplified noise.
    """
    step = max(1, int(sigma_px / _LEAST_COARSE_SIGMA_PX))
    weight = None if mask.all() else mask.astype(np.float32)
    coverage = None if weight is None else np.maximum(_smooth(weight, sigma_px, step), np.float32(1e-6))

    def local_mean(values: ImageArray) -> ImageArray:
        if weight is None or coverage is None:
            return _smooth(values, sigma_px, step)
        return np.divide(_smooth(values * weight, sigma_px, step), coverage, dtype=np.float32)

    deviation = image - local_mean(image)
    if weight is not None:
        deviation *= weight
    spread = np.sqrt(np.maximum(local_mean(deviation * deviation), 0))
    typical = spread[::step, ::step][mask[::step, ::step]]
    floor = 0.2 * float(np.median(typical)) if len(typical) else 0.0
    deviation *= _DEVIATION / np.maximum(spread, max(floor, 1e-6))
    deviation += _MEAN
    grey: NDArray[np.uint8] = np.clip(np.rint(deviation), 0, 255).astype(np.uint8)
    return grey


def _smooth(values: ImageArray, sigma_px: float, step: int) -> ImageArray:
    """Return a Gaussian mean of values (H, W), by way of an image `step` times smaller."""
    if step == 1:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma_px))
    height, width = values.shape
    rows, cols = -(-height // step), -(-width // step)
    # Whole blocks, so that both resolutions share their centres and nothing shifts.
    filled = cv2.copyMakeBorder(values, 0, rows * step - height, 0, cols * step - width, cv2.BORDER_REFLECT_101)
    coarse = cv2.resize(filled, (cols, rows), interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), sigma_px / step)
    smooth = cv2.resize(coarse, (cols * step, rows * step), interpolation=cv2.INTER_LINEAR)
    return np.asarray(smooth[:height, :width])
