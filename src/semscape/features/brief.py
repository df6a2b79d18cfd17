"""BRIEF (Calonder et al. 2010) on STAR keypoints (Agrawal et al. 2008), both from OpenCV's contributions."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.features.found import Found, least_blob_height
from semscape.features.peak import nearest_peak
from semscape.types import Keypoints

_BYTES = 32
# Half of the 48 px over which pixels are compared, and of the 9 px over which they are smoothed. It does not
# change with the keypoint's scale, nor turn with its orientation.
_REACH_PX = 28.0
# STAR ignores a border of one and a half times its largest filter; BRIEF needs 28 px anyway.
_LARGEST_PX = 22
# What STAR says of a blob of unit height whose sigma is half its size.
_RESPONSE_OF_UNIT_BLOB = 0.5
_NO_LINES_PROJECTED, _NO_LINES_BINARIZED, _NEIGHBOURHOOD_PX = 10, 8, 5


def find_brief(image: NDArray[np.uint8], contrast_threshold: float) -> Found:
    """Find the blobs of an image (H, W) by STAR, and describe them by BRIEF.

    STAR gives whole pixels; each is moved to the peak of the Laplacian of Gaussian beside it, and dropped where there
    is none. Orientations are 0: the descriptor is upright.

    References
    ----------
    Calonder et al. 2010, doi:10.1007/978-3-642-15561-1_56; Agrawal et al. 2008, doi:10.1007/978-3-540-88693-8_8
    """
    threshold = max(1, round(_RESPONSE_OF_UNIT_BLOB * least_blob_height(contrast_threshold)))
    star = cv2.xfeatures2d.StarDetector_create(  # type: ignore[attr-defined]
        _LARGEST_PX, threshold, _NO_LINES_PROJECTED, _NO_LINES_BINARIZED, _NEIGHBOURHOOD_PX
    )
    brief = cv2.xfeatures2d.BriefDescriptorExtractor_create(_BYTES)  # type: ignore[attr-defined]
    points, descriptors = brief.compute(image, star.detect(image))
    pixel = np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2)
    size = np.array([point.size for point in points], dtype=np.float64)
    xy, blob_height, is_peak = pixel.copy(), np.empty(len(pixel)), np.zeros(len(pixel), dtype=bool)
    for one in np.unique(size):
        own = size == one
        xy[own], blob_height[own], is_peak[own] = nearest_peak(image, np.rint(pixel[own]).astype(np.int64), one / 2)
    keypoints = Keypoints(
        xy=xy,
        scale_px=size / 2,
        orientation_rad=np.zeros(len(pixel)),
        response=np.abs(blob_height),
        descriptors=np.empty((0, _BYTES), np.uint8) if descriptors is None or len(points) == 0 else descriptors,
        kind="brief",
    )
    return Found(keypoints, np.full(len(pixel), _REACH_PX)).only(is_peak)
