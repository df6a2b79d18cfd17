"""Keypoints spread over the image: adaptive non-maximal suppression."""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray, IntArray

CLEARLY_STRONGER = 0.9
"""A keypoint is suppressed by those whose response times this exceeds its own."""


def suppression_radius_px(xy: FloatArray, response: FloatArray) -> FloatArray:
    """Return the distance of each keypoint to the nearest clearly stronger one.

    Keypoints with the largest radii are strong where they are and far from each other. Exact, and for N keypoints
    in about N log N steps: they are entered from strong to weak into a grid of cells, and each looks around
    itself in widening rings.

    Parameters
    ----------
    xy : (N, 2) float array
        In px.
    response : (N,) float array
        Strength, not negative.

    Returns
    -------
    (N,) float array
        In px; infinite for the strongest ones.

    Raises
    ------
    ValueError
        If a response is negative.

    References
    ----------
    Brown, Szeliski & Winder 2005, doi:10.1109/CVPR.2005.235

    Examples
    --------
    >>> suppression_radius_px(np.array([[0.0, 0], [3, 4], [3, 5]]), np.array([9.0, 7, 8])).round(2).tolist()
    [inf, 1.0, 5.83]
    """
    if (response < 0).any():
        raise ValueError(f"responses must not be negative, the least is {response.min()}")
    radius = np.full(len(xy), np.inf)
    if len(xy) < 2:
        return radius
    order = np.argsort(-response, kind="stable")
    corner = xy.min(axis=0)
    extent = np.maximum(xy.max(axis=0) - corner, 1.0)
    cell_px = max(float(np.sqrt(extent[0] * extent[1] / len(xy))), float(extent.max()) / 4096)
    cell = ((xy - corner) / cell_px).astype(np.int64)
    head = np.full(tuple(cell.max(axis=0)[::-1] + 1), -1, dtype=np.int64)
    _enter(xy, cell, order.astype(np.int64), response, cell_px, head, radius)
    return radius


@njit(cache=True, nogil=True)
def _enter(
    xy: FloatArray,
    cell: IntArray,
    order: IntArray,
    response: FloatArray,
    cell_px: float,
    head: IntArray,
    radius: FloatArray,
) -> None:
    rows, cols = head.shape
    following = np.full(len(order), -1, dtype=np.int64)
    entered = 0
    for n in order:
        while response[order[entered]] * CLEARLY_STRONGER > response[n]:
            other = order[entered]
            following[other] = head[cell[other, 1], cell[other, 0]]
            head[cell[other, 1], cell[other, 0]] = other
            entered += 1
        col, row = cell[n, 0], cell[n, 1]
        nearest = np.inf
        ring = 0
        # What lies in ring k is at least k - 1 cells away.
        while entered > 0 and ring < max(rows, cols) and (ring - 1) * cell_px < np.sqrt(nearest):
            for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
                on_edge = r == row - ring or r == row + ring
                step = 1 if on_edge or ring == 0 else 2 * ring
                for c in range(col - ring, col + ring + 1, step):
                    if c < 0 or c >= cols:
                        continue
                    other = head[r, c]
                    while other >= 0:
                        dx, dy = xy[other, 0] - xy[n, 0], xy[other, 1] - xy[n, 1]
                        nearest = min(nearest, dx * dx + dy * dy)
                        other = following[other]
            ring += 1
        radius[n] = np.sqrt(nearest)
