"""Match two views' descriptors: exact mutual nearest neighbours that pass the ratio test."""

from __future__ import annotations

import numpy as np

from semscape.features.nearest import two_nearest
from semscape.types import Keypoints, Matches


def match(
    pair: tuple[int, int], keypoints1: Keypoints, keypoints2: Keypoints, *, ratio: float, workers: int = 1
) -> Matches:
    """Match the keypoints of two views by mutual nearest neighbours that pass the ratio test.

    Parameters
    ----------
    pair : (int, int)
        View indices i1 < i2.
    keypoints1, keypoints2 : Keypoints
        With descriptors of one kind, float or binary.
    ratio : float
        Largest ratio of the nearest to the second nearest distance, in (0, 1].
    workers : int
        Threads; no result depends on it.

    Returns
    -------
    Matches
        `indices` (M, 2) sorted by the first column, `distance` (M,) in units of a float descriptor's length, or as
        the share of a binary descriptor's bits that differ.

    References
    ----------
    Lowe 2004, doi:10.1023/B:VISI.0000029664.99615.94
    """
    if not 0 < ratio <= 1:
        raise ValueError(f"ratio is {ratio}, must lie in (0, 1]")
    if len(keypoints1) < 2 or len(keypoints2) < 2:
        return Matches(pair, np.empty((0, 2), np.int64), np.empty(0))
    described1, described2 = keypoints1.descriptors, keypoints2.descriptors
    nearest, distance, second, back = two_nearest(described1, described2, workers=workers)
    binary = described1.dtype == np.uint8
    rows = np.arange(len(nearest))
    good = (back[nearest] == rows) & (distance < (ratio if binary else ratio * ratio) * second)
    indices = np.column_stack([rows[good], nearest[good]]).astype(np.int64)
    if binary:
        return Matches(pair, indices, distance[good] / (8 * described1.shape[1]))
    return Matches(pair, indices, np.sqrt(distance[good]) / float(np.linalg.norm(described1[0])))
