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
from semscape.options import FeaturesOptions
from semscape.types import BoolArray, FloatArray, ImageArray, Keypoints, Micrograph

# RootSIFT times this, rounded: dot products of such vectors stay below 2^24, so a float32 matrix product is
# exact whatever its order of summation, and the matches are the same on every machine and thread count.
DESCRIPTOR_LEVELS = 1023

_MASK_MARGIN_PX = 3.0
_DESCRIPTOR_RADIUS_IN_SCALES = 6.0


def detect(view: Micrograph, options: FeaturesOptions) -> Keypoints:
    """Detect and describe the keypoints of a view.

    Parameters
    ----------
    view : Micrograph
        Image (H, W) with its mask.
    options : FeaturesOptions
        Detector, contrast threshold, normalization and the largest number of keypoints.

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
    Lowe 2004, doi:10.1023/B:VISI.0000029664.99615.94; RootSIFT: Arandjelovic & Zisserman 2012,
    doi:10.1109/CVPR.2012.6248018.
    """
    if options.detector not in DETECTORS:
        raise ValueError(f"detector {options.detector!r} is unknown, known are {sorted(DETECTORS)}")
    normalized = normalize_contrast(view.image, view.mask, options.normalization_sigma_px)
    keypoints = DETECTORS[options.detector](normalized, view.mask, options)
    if len(keypoints) == 0:
        raise TooFewMatchesError(
            f"{view.name}: no keypoint found in {view.image.shape[1]} x {view.image.shape[0]} px; "
            "the image is featureless or out of focus, take it again with more contrast"
        )
    return keypoints


def normalize_contrast(image: ImageArray, mask: BoolArray, sigma_px: float) -> NDArray[np.uint8]:
    """Return the image (H, W) with local mean 128 and local standard deviation 40, as uint8.

    Local means are Gaussian, of `sigma_px`, over the pixels where `mask` is True. The local deviation is
    floored at a fifth of its median so that empty background does not turn into amplified noise.
    """
    weight = mask.astype(np.float32)
    coverage = np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma_px), 1e-6)
    mean = cv2.GaussianBlur(image * weight, (0, 0), sigma_px) / coverage
    deviation = (image - mean) * weight
    variance = cv2.GaussianBlur(deviation * deviation, (0, 0), sigma_px) / coverage
    spread = np.sqrt(np.maximum(variance, 0))
    floor = 0.2 * float(np.median(spread[mask])) if mask.any() else 0.0
    scaled = 128.0 + 40.0 * deviation / np.maximum(spread, max(floor, 1e-6))
    grey: NDArray[np.uint8] = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    return grey


def _detect_sift(image: NDArray[np.uint8], mask: BoolArray, options: FeaturesOptions) -> Keypoints:
    sift = cv2.SIFT_create(  # type: ignore[attr-defined]
        nfeatures=0, contrastThreshold=options.contrast_threshold, edgeThreshold=10.0, enable_precise_upscale=True
    )
    found, descriptors = sift.detectAndCompute(image, mask.astype(np.uint8))
    if not found:
        return _no_keypoints("sift", 128)
    xy = np.array([point.pt for point in found], dtype=np.float64)
    scale = np.array([point.size for point in found], dtype=np.float64) / 2
    orientation = np.deg2rad(np.array([point.angle for point in found], dtype=np.float64))
    response = np.array([point.response for point in found], dtype=np.float64)
    keep = _clear_of_mask(xy, scale, mask)
    strongest = np.flatnonzero(keep)
    if len(strongest) > options.max_keypoints:
        order = np.argsort(-response[strongest], kind="stable")[: options.max_keypoints]
        strongest = strongest[order]
    order = np.lexsort((orientation[strongest], scale[strongest], xy[strongest, 0], xy[strongest, 1]))
    chosen = strongest[order]
    return Keypoints(
        xy=xy[chosen],
        scale_px=scale[chosen],
        orientation_rad=orientation[chosen],
        response=response[chosen],
        descriptors=root_sift(descriptors[chosen]),
        kind="sift",
    )


def root_sift(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the Hellinger-normalized SIFT descriptors (N, 128) as whole numbers up to `DESCRIPTOR_LEVELS`.

    Examples
    --------
    >>> root_sift(np.array([[3.0, 1.0, 0.0]], dtype=np.float32)).tolist()
    [[886.0, 512.0, 0.0]]
    """
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    levels: NDArray[np.float32] = np.rint(DESCRIPTOR_LEVELS * np.sqrt(descriptors / total)).astype(np.float32)
    return levels


def _clear_of_mask(xy: FloatArray, scale_px: FloatArray, mask: BoolArray) -> BoolArray:
    """Tell which keypoints lie farther from masked pixels than their descriptor reaches."""
    if mask.all():
        return np.ones(len(xy), dtype=bool)
    distance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    col = np.clip(np.rint(xy[:, 0]).astype(int), 0, mask.shape[1] - 1)
    row = np.clip(np.rint(xy[:, 1]).astype(int), 0, mask.shape[0] - 1)
    clear: BoolArray = distance[row, col] > np.maximum(_DESCRIPTOR_RADIUS_IN_SCALES * scale_px, _MASK_MARGIN_PX)
    return clear


def _no_keypoints(kind: str, dimension: int) -> Keypoints:
    empty = np.empty(0)
    return Keypoints(np.empty((0, 2)), empty, empty, empty, np.empty((0, dimension), np.float32), kind)


DETECTORS: dict[str, Callable[[NDArray[np.uint8], BoolArray, FeaturesOptions], Keypoints]] = {"sift": _detect_sift}
