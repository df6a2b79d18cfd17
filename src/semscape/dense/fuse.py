"""Bring the heights of all pairs to zero tilt and fuse them."""

from __future__ import annotations

import numpy as np

from semscape.compiled import njit
from semscape.types import FloatArray

_STRETCH_LIMIT_PX = 3.0
_DISPARITY_NOISE_PX = 0.5
_AGREEMENT_IN_SIGMAS = 3.0
_BLOCK_ROWS = 64


@njit(cache=True, nogil=True)
def to_zero_tilt(height_px: FloatArray, parallax: float) -> FloatArray:
    """Move heights (H, W), known at the pixels of a tilted view, to the grid at zero tilt.

    A height h seen at u belongs to u - h parallax. Between neighbours of a row that stay together the surface is
    drawn as a line; where it parts (a depth jump) nothing is drawn; where it folds over itself the top wins.
    """
    rows, columns = height_px.shape
    moved = np.full((rows, columns), np.nan)
    for row in range(rows):
        for col in range(columns):
            h1 = height_px[row, col]
            if np.isnan(h1):
                continue
            u1 = col - h1 * parallax
            h2 = height_px[row, col + 1] if col + 1 < columns else np.nan
            u2 = col + 1 - h2 * parallax
            if np.isnan(h2) or abs(u2 - u1) > _STRETCH_LIMIT_PX:
                h2, u2 = h1, u1 + 0.5  # an end of the surface still covers half a pixel beyond
                u1 = u1 - 0.5
            if u2 < u1:
                u1, u2, h1, h2 = u2, u1, h2, h1
            for target in range(max(int(np.ceil(u1)), 0), min(int(np.floor(u2)), columns - 1) + 1):
                share = (target - u1) / (u2 - u1) if u2 > u1 else 0.0
                h = h1 + share * (h2 - h1)
                if np.isnan(moved[row, target]) or h > moved[row, target]:
                    moved[row, target] = h
    return moved


def fuse(heights_px: list[FloatArray], baselines: list[float]) -> tuple[FloatArray, FloatArray]:
    """Fuse height maps of one grid robustly.

    Each map's sigma is the disparity noise over its baseline. The weighted median picks the consensus; the
    maps within 3 sigma of it are averaged with inverse-variance weights.

    Parameters
    ----------
    heights_px : list of (H, W) float arrays
        Heights at zero tilt, NaN where unknown.
    baselines : list of float
        Difference of parallax of each pair.

    Returns
    -------
    height_px : (H, W) float array
        NaN where no map knows, or where several know and no majority agrees.
    support : (H, W) float array
        Number of maps that agree.
    """
    fused, support = np.empty(heights_px[0].shape), np.empty(heights_px[0].shape)
    for first in range(0, len(fused), _BLOCK_ROWS):
        rows = slice(first, first + _BLOCK_ROWS)
        fused[rows], support[rows] = _fuse_rows(np.stack([height[rows] for height in heights_px]), baselines)
    return fused, support


def _fuse_rows(stack: FloatArray, baselines: list[float]) -> tuple[FloatArray, FloatArray]:
    """Fuse some rows: many arrays of the stack's size are needed, which for whole maps would be the most memory."""
    precision = np.abs(np.array(baselines)) / _DISPARITY_NOISE_PX
    known = np.isfinite(stack)
    weight = np.where(known, (precision**2)[:, None, None], 0.0)
    order = np.argsort(np.where(known, stack, np.inf), axis=0)
    ranked = np.cumsum(np.take_along_axis(weight, order, axis=0), axis=0)
    half = np.argmax(ranked >= 0.5 * ranked[-1], axis=0)
    median = np.take_along_axis(stack, np.take_along_axis(order, half[None], axis=0), axis=0)[0]
    with np.errstate(invalid="ignore"):
        agrees = known & (np.abs(stack - median) * precision[:, None, None] <= _AGREEMENT_IN_SIGMAS)
    weight = np.where(agrees, weight, 0.0)
    total = weight.sum(axis=0)
    support = agrees.sum(axis=0)
    majority = (2 * support > known.sum(axis=0)) & (total > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, stack * weight, 0.0).sum(axis=0) / total
    return np.where(majority, mean, np.nan), np.where(majority, support, 0.0)
