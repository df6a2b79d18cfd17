"""ORB (Rublee et al. 2011) from OpenCV, with sub-pixel places."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.features.found import Found, least_blob_height
from semscape.features.peak import nearest_peak
from semscape.types import Keypoints

_LEVELS = 8
_FACTOR = 1.2
_PATCH_PX = 31
# A blob that FAST sees well: nine pixels in a row, on a circle of radius 3 px, must differ from the centre, and at
# two sigma all but 14 % of a blob's height is gone.
_BLOB_SIGMA_PX = 1.5
_SHARE_AT_CIRCLE = 1 - np.exp(-2)
_EVERY_ONE = 10_000_000


def find_orb(image: NDArray[np.uint8], contrast_threshold: float) -> Found:
    """Find and describe the FAST corners of an image (H, W) at eight scales.

    OpenCV gives whole pixels of a scale's own image, times the scale: without the half pixels from the corner to the
    centre of pixel (0, 0), up to 1.3 px wrong. That is put right, and each is moved to the peak of the Laplacian of
    Gaussian beside it. Corners without one, whose place is known to a pixel only, are dropped.

    References
    ----------
    Rublee et al. 2011, doi:10.1109/ICCV.2011.6126544
    """
    fast_threshold = max(1, round(_SHARE_AT_CIRCLE * least_blob_height(contrast_threshold)))
    orb = cv2.ORB_create(  # type: ignore[attr-defined]
        nfeatures=_EVERY_ONE,
        scaleFactor=_FACTOR,
        nlevels=_LEVELS,
        edgeThreshold=_PATCH_PX,
        patchSize=_PATCH_PX,
        fastThreshold=fast_threshold,
    )
    points, descriptors = orb.detectAndCompute(image, None)
    given = np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2)
    level = np.array([point.octave for point in points], dtype=np.int64)
    xy = np.empty_like(given)
    blob_height, is_peak = np.empty(len(given)), np.zeros(len(given), dtype=bool)
    height, width = image.shape
    scaled = image
    for number in range(int(level.max(initial=-1)) + 1):
        factor = _FACTOR**number
        if number:
            size = round(width / factor), round(height / factor)
            scaled = cv2.resize(scaled, size, interpolation=cv2.INTER_LINEAR_EXACT)
        own = level == number
        pixel = np.rint(given[own] / factor).astype(np.int64)
        peak, blob_height[own], is_peak[own] = nearest_peak(scaled, pixel, _BLOB_SIGMA_PX)
        xy[own] = (peak + 0.5) * [width / scaled.shape[1], height / scaled.shape[0]] - 0.5
    factors = np.power(_FACTOR, level, dtype=np.float64)
    keypoints = Keypoints(
        xy=xy,
        scale_px=_BLOB_SIGMA_PX * factors,
        orientation_rad=np.deg2rad(np.array([point.angle for point in points], dtype=np.float64)),
        response=np.abs(blob_height),
        descriptors=np.empty((0, 32), np.uint8) if descriptors is None else descriptors,
        kind="orb",
    )
    return Found(keypoints, _PATCH_PX / 2 * factors).only(is_peak)
