"""Where an image holds nothing at all: the void around a body that stands free, clipped to black.

Beside noise, however weak, no height of the void matches better than another by much, and the views disagree. But where
an image is one grey, all heights match perfectly, and the outline beside it is the only thing that windows see.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from semscape.types import BoolArray, Micrograph, TiltSeries

_WINDOW_PX = 7
# Of images that are resampled, and so no whole numbers.
_ROUNDING = 1e-5


def blank(view: Micrograph) -> BoolArray:
    """Return where (H, W) no pixel of the surrounding 7 x 7 differs from another by more than one grey level.

    Examples
    --------
    >>> grey = np.zeros((9, 20), np.float32)
    >>> grey[:, 12:] = np.random.default_rng(0).integers(0, 50, (9, 8))
    >>> blank(Micrograph("void.tif", grey, grey >= 0)).any(axis=0).astype(int)
    array([1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    """
    image = view.image
    one_level = _ROUNDING * float(np.abs(image).max()) if np.any(image % 1) else 1.0
    square = np.ones((_WINDOW_PX, _WINDOW_PX), np.uint8)
    found: BoolArray = cv2.dilate(image, square) - cv2.erode(image, square) <= one_level
    return found


def without_blank(series: TiltSeries) -> TiltSeries:
    """Return a series whose masks leave out what is blank."""
    views = tuple(replace(view, mask=view.mask & ~blank(view)) for view in series.views)
    return replace(series, views=views)
