"""SIFT (Lowe 2004) from OpenCV, described as RootSIFT in whole numbers."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.features.found import Found, joined
from semscape.types import Keypoints

# RootSIFT times this, rounded: dot products of such vectors stay below 2^24, so a float32 matrix product is
# exact whatever its order of summation, and the matches are the same on every machine and thread count.
DESCRIPTOR_LEVELS = 1023

# The descriptor's grid is 4 bins of 3 scales wide.
_REACH_IN_SCALES = 6.0

# Tiles begin at multiples of the coarsest octave's step that matters, so that they halve like the whole image does.
_LARGEST_WHOLE_PX = 2**21
_TILE_PX, _OVERLAP_PX = 1024, 128
_LARGEST_SCALE_PX = 15.0


def find_sift(image: NDArray[np.uint8], contrast_threshold: float) -> Found:
    """Find and describe the blobs of an image (H, W) where the difference of Gaussians peaks.

    An image of more than 2 megapixels is taken in tiles, for its pyramid is 60 times its size. In it blobs of more than
    15 px in scale are left out, whose surroundings may reach beyond a tile.

    References
    ----------
    Lowe 2004, doi:10.1023/B:VISI.0000029664.99615.94; RootSIFT: Arandjelovic & Zisserman 2012,
    doi:10.1109/CVPR.2012.6248018.
    """
    # Without the precise up-scaling every keypoint is shifted by a quarter of a pixel.
    sift = cv2.SIFT_create(  # type: ignore[attr-defined]
        nfeatures=0, contrastThreshold=contrast_threshold, edgeThreshold=10.0, enable_precise_upscale=True
    )
    if image.size <= _LARGEST_WHOLE_PX:
        return _in_one_piece(sift, image)
    rows, columns = image.shape
    places = product(range(0, rows, _TILE_PX), range(0, columns, _TILE_PX))
    return joined([_in_tile(sift, image, top, left) for top, left in places])


def _in_tile(sift: Any, image: NDArray[np.uint8], top: int, left: int) -> Found:
    """Find what a tile holds, looking beyond its borders."""
    begin = np.maximum([top - _OVERLAP_PX, left - _OVERLAP_PX], 0)
    end = np.array([top, left]) + _TILE_PX
    part = image[begin[0] : end[0] + _OVERLAP_PX, begin[1] : end[1] + _OVERLAP_PX]
    found = _in_one_piece(sift, np.ascontiguousarray(part))
    xy = found.keypoints.xy + begin[::-1]
    place = np.floor(xy + 0.5)
    own = ((place >= [left, top]) & (place < end[::-1])).all(axis=1) & (found.keypoints.scale_px <= _LARGEST_SCALE_PX)
    return Found(replace(found.keypoints, xy=xy), found.reach_px).only(own)


def _in_one_piece(sift: Any, image: NDArray[np.uint8]) -> Found:
    points, descriptors = sift.detectAndCompute(image, None)
    scale = np.array([point.size for point in points], dtype=np.float64) / 2
    keypoints = Keypoints(
        xy=np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2),
        scale_px=scale,
        orientation_rad=np.deg2rad(np.array([point.angle for point in points], dtype=np.float64)),
        response=np.array([point.response for point in points], dtype=np.float64),
        descriptors=root_sift(np.empty((0, 128), np.float32) if descriptors is None else descriptors),
        kind="sift",
    )
    return Found(keypoints, _REACH_IN_SCALES * scale)


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
