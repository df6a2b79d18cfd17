"""Specks of unknown heights in a surface that goes on: told from the hidden ground beside a jump, and bridged.

Pairs that disagree at a pixel, a failed left-right check, or a spike that was dropped leave specks of a few unknown
pixels everywhere, most of all on steep flanks, where a few pixels span as much disparity as a jump. Whether there is
one is asked of the most probable surface, which is smooth but for its jumps: where it, led on from both sides of a
speck with its own slopes, meets within what is no jump, the speck is a gap of the matching and not of the surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.dense.evidence import SPECK_PX, RefinedHeights, specks
from semscape.dense.given import JUMP_PX, median_of, near_jumps
from semscape.dense.stereo import filled_from_nearest
from semscape.types import BoolArray, FloatArray, ImageArray

# Slopes are told from heights so far apart.
_SLOPE_PX = 3
# Nearer to a jump than this even known heights err by more than they say.
_FROM_JUMP_PX = 4
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))


def without_specks(refined: RefinedHeights, baseline: float) -> RefinedHeights:
    """Bridge specks of unknown heights in which no square of 5 x 5 px fits, away from depth jumps.

    In every direction in which an unknown pixel has known heights on both sides, at most 4 px away, the surfaces there
    must meet: led on to the middle with their own slopes they differ by no more than a jump, and from side to side the
    heights change by no more than that per px. The pixel's height is the mean of the straight lines between them; its
    variance that of the less certain side and of half of what the sides miss each other by.

    Parameters
    ----------
    refined : RefinedHeights
    baseline : float
        Parallax between the extreme views, px of image per px of height.

    Examples
    --------
    A gap in a flank that rises by 3.5 px of disparity over 5 px, and one beside a wall:

    >>> flank = np.tile(0.7 * np.arange(20.0), (20, 1))
    >>> wall = np.where(np.arange(20) < 10, 0.0, 8.0) * np.ones((20, 1))
    >>> for height in (flank, wall):
    ...     sigma = np.full(height.shape, 0.1)
    ...     height[10, 10:12] = sigma[10, 10:12] = np.nan
    ...     period, views = sigma.astype(np.float32), np.full(height.shape, 3, np.uint8)
    ...     found = RefinedHeights(height, sigma, views, period, 0.0, np.ones_like(period))
    ...     print(without_specks(found, 1.0).height[10, 9:13].round(6).tolist())
    [6.3, 7.0, 7.7, 8.4]
    [0.0, nan, nan, 8.0]
    """
    known = np.isfinite(refined.height)
    if not known.any():
        return refined
    limit = JUMP_PX / baseline
    height, uncertainty, period = refined.height.copy(), refined.uncertainty.copy(), refined.lateral_period_px.copy()
    n_views, share = refined.n_views.copy(), refined.slow_share.copy()
    rows, cols = np.nonzero(specks(~known))
    _bridge(known, rows, cols, limit, height, uncertainty, n_views, period, share)
    # What is left unknown between heights that differ by a jump shows as one now.
    wrong = ~known & near_jumps(median_of(filled_from_nearest(height)), limit, _FROM_JUMP_PX)
    for plane in (height, uncertainty, period, share):
        plane[wrong] = np.nan
    n_views[wrong] = 0
    return replace(
        refined, height=height, uncertainty=uncertainty, n_views=n_views, lateral_period_px=period, slow_share=share
    )


@njit(cache=True, nogil=True)
def _bridge(
    known: BoolArray,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    limit: float,
    height: FloatArray,
    uncertainty: FloatArray,
    n_views: NDArray[np.uint8],
    period: ImageArray,
    share: ImageArray,
) -> None:  # pragma: no cover - compiled
    """Fill in place what is unknown at the given places (N,) and where both sides meet."""
    for row, col in zip(rows, cols):  # noqa: B905 - not in compiled code
        lines, total, variance, gap = 0, 0.0, 0.0, 0.0
        views, longest, most = np.uint8(255), np.float32(0), np.float32(0)
        for down, right in _DIRECTIONS:
            after, before = _away(known, row, col, down, right), _away(known, row, col, -down, -right)
            if not (after and before):
                continue
            span = after + before
            r1, c1, r2, c2 = row + after * down, col + after * right, row - before * down, col - before * right
            rise = height[r1, c1] - height[r2, c2]
            leaning = _slope(known, height, r1, c1, down, right) - _slope(known, height, r2, c2, -down, -right)
            missed = abs(rise - leaning * span / 2)
            if abs(rise) > limit * span * np.hypot(down, right) or missed > limit:
                lines = 0
                break
            lines += 1
            total += (height[r1, c1] * before + height[r2, c2] * after) / span
            variance += max(uncertainty[r1, c1], uncertainty[r2, c2]) ** 2
            gap = max(gap, missed)
            views = min(views, n_views[r1, c1], n_views[r2, c2])
            longest = max(longest, period[r1, c1], period[r2, c2])
            most = max(most, share[r1, c1], share[r2, c2])
        if lines:
            height[row, col] = total / lines
            uncertainty[row, col] = np.sqrt(variance / lines + (gap / 2) ** 2)
            n_views[row, col], period[row, col], share[row, col] = views, longest, most


@njit(cache=True, nogil=True)
def _away(known: BoolArray, row: int, col: int, down: int, right: int) -> int:  # pragma: no cover - compiled
    """Return how many steps away the next known height is, 0 where none is near enough."""
    for far in range(1, SPECK_PX):
        r, c = row + far * down, col + far * right
        if not (0 <= r < known.shape[0] and 0 <= c < known.shape[1]):
            return 0
        if known[r, c]:
            return far
    return 0


@njit(cache=True, nogil=True)
def _slope(
    known: BoolArray, height: FloatArray, row: int, col: int, down: int, right: int
) -> float:  # pragma: no cover - compiled
    """Return by how much heights rise per step away from a place; 0 where it stands alone."""
    for far in range(_SLOPE_PX, 0, -1):
        r, c = row + far * down, col + far * right
        if 0 <= r < known.shape[0] and 0 <= c < known.shape[1] and known[r, c]:
            return float(height[r, c] - height[row, col]) / far
    return 0.0
