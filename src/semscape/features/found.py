"""What every detector gives, and the one measure of contrast that all of them are set by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from semscape.types import FloatArray, Keypoints

# The height, in grey levels, of the Gaussian blob that SIFT just finds at a contrast threshold of 1. SIFT divides
# its threshold by the 3 layers of an octave; a blob of height A peaks at 0.115 A in the difference of Gaussians.
_BLOB_HEIGHT = 255 / 3 / 0.115


class Found(NamedTuple):
    """All keypoints of an image, in no particular order, and how far each descriptor reaches (N,), in px."""

    keypoints: Keypoints
    reach_px: FloatArray

    def only(self, rows: Any) -> Found:
        """Return the keypoints of these rows: indices, in this order, or a mask."""
        every = self.keypoints
        keypoints = replace(
            every,
            xy=every.xy[rows],
            scale_px=every.scale_px[rows],
            orientation_rad=every.orientation_rad[rows],
            response=every.response[rows],
            descriptors=every.descriptors[rows],
        )
        return Found(keypoints, self.reach_px[rows])


def joined(parts: Sequence[Found]) -> Found:
    """Return the keypoints of all parts, one after the other."""
    every = [part.keypoints for part in parts]
    keypoints = replace(
        every[0],
        xy=np.concatenate([part.xy for part in every]),
        scale_px=np.concatenate([part.scale_px for part in every]),
        orientation_rad=np.concatenate([part.orientation_rad for part in every]),
        response=np.concatenate([part.response for part in every]),
        descriptors=np.concatenate([part.descriptors for part in every]),
    )
    return Found(keypoints, np.concatenate([part.reach_px for part in parts]))


def least_blob_height(contrast_threshold: float) -> float:
    """Return the height in grey levels of the faintest Gaussian blob that is to be found.

    Examples
    --------
    >>> round(least_blob_height(0.01), 1)
    7.4
    """
    return _BLOB_HEIGHT * contrast_threshold
