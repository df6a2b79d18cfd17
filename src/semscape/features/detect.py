"""Detect and describe keypoints of one micrograph.

Low contrast is normal in a SEM, and brightness and contrast are set by hand for each view. So the image is
normalized by its local mean and standard deviation before detection; no threshold depends on the grey
levels of the file.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.errors import TooFewMatchesError
from semscape.features.brief import find_brief
from semscape.features.found import Found
from semscape.features.normalize import normalize_contrast
from semscape.features.orb import find_orb
from semscape.features.sift import find_sift
from semscape.features.spread import suppression_radius_px
from semscape.features.surf import find_surf
from semscape.options import FeaturesOptions
from semscape.types import BoolArray, Keypoints, Micrograph

# Each takes a normalized image (H, W) and the contrast threshold.
DETECTORS: dict[str, Callable[[NDArray[np.uint8], float], Found]] = {
    "sift": find_sift,
    "surf": find_surf,
    "orb": find_orb,
    "brief": find_brief,
}

_MASK_MARGIN_PX = 3.0


def detect(view: Micrograph, options: FeaturesOptions) -> Keypoints:
    """Detect and describe the keypoints of a view.

    Parameters
    ----------
    view : Micrograph
        Image (H, W) with its mask.
    options : FeaturesOptions
        Detector, contrast threshold, normalization, and the largest number of keypoints with what decides then.

    Returns
    -------
    Keypoints
        Sorted by (y, x, scale, orientation); `xy` in px, the centre of the top-left pixel at (0, 0).

    Raises
    ------
    ValueError
        For an unknown detector.
    TooFewMatchesError
        When the image holds no keypoint at all.

    References
    ----------
    See `semscape.features.sift`, `surf`, `orb` and `brief`.
    """
    if options.detector not in DETECTORS:
        raise ValueError(f"detector {options.detector!r} is unknown, known are {sorted(DETECTORS)}")
    normalized = normalize_contrast(view.image, view.mask, options.normalization_sigma_px)
    found = DETECTORS[options.detector](normalized, options.contrast_threshold)
    clear = found.only(_clear_of_mask(found, view.mask))
    keypoints = clear.keypoints
    if len(keypoints) == 0:
        raise TooFewMatchesError(
            f"{view.name}: no keypoint found in {view.image.shape[1]} x {view.image.shape[0]} px; "
            "the image is featureless or out of focus, take it again with more contrast"
        )
    x, y = keypoints.xy.T
    # By place, so that the order depends on nothing else; the descriptor tells apart what shares all the rest.
    order = np.lexsort((keypoints.descriptors[:, 0], keypoints.orientation_rad, keypoints.scale_px, x, y))
    if len(order) > options.max_keypoints:
        response = keypoints.response[order]
        radius = suppression_radius_px(keypoints.xy[order], response) if options.spread else np.zeros(len(order))
        order = order[np.sort(np.lexsort((-response, -radius))[: options.max_keypoints])]
    return clear.only(order).keypoints


def _clear_of_mask(found: Found, mask: BoolArray) -> BoolArray:
    """Tell which keypoints lie farther from masked pixels than their descriptor reaches."""
    if mask.all():
        return np.ones(len(found.reach_px), dtype=bool)
    distance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    xy = found.keypoints.xy
    col = np.clip(np.rint(xy[:, 0]).astype(int), 0, mask.shape[1] - 1)
    row = np.clip(np.rint(xy[:, 1]).astype(int), 0, mask.shape[0] - 1)
    clear: BoolArray = distance[row, col] > np.maximum(found.reach_px, _MASK_MARGIN_PX)
    return clear
