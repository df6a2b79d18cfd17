"""Heights as pairs and sweeps give them: how sure they are, and smoothed as far as they say the surface is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from semscape.dense.posterior import (
    DataTerm,
    LatticeTable,
    Smoothness,
    most_probable,
    smoothness_by_evidence,
    smoothness_cut,
)
from semscape.types import BoolArray, FloatArray

# A step of the disparity beyond this is a depth jump.
JUMP_PX = 1.0
# The noise of the given heights' disparity, and over how many pixels it errs alike: 77 to 127 on simulated series.
GIVEN_NOISE_PX = 0.6
_GIVEN_CORRELATED = 80.0
_SPIKE_PX = 5
_START_TAU = 0.5
_ROUNDS, _STEPS = 3, 60


@dataclass(frozen=True)
class SmoothedHeights:
    """Heights (H, W) that are smoothed, the stiffness (H, W) with which those given hold them, and their smoothness.

    `cut` are the weights of their second differences, 0 across depth jumps.
    """

    height: FloatArray
    stiffness: FloatArray
    cut: tuple[FloatArray, FloatArray, FloatArray]
    prior: Smoothness


def smoothed(given: FloatArray, known: BoolArray, baseline: float, table: LatticeTable) -> SmoothedHeights:
    """Smooth given heights by evidence, but not across depth jumps.

    Parameters
    ----------
    given : (H, W) float array
        In px, without spikes, some height where unknown.
    known : (H, W) bool array
    baseline : float
        Parallax between the extreme views, px of image per px of height.
    table : LatticeTable

    References
    ----------
    MacKay 1992, doi:10.1162/neco.1992.4.3.415.
    """
    cut = smoothness_cut(np.where(known, given, np.nan), JUMP_PX / baseline)
    prior = Smoothness(np.full(given.shape, _START_TAU**2), np.ones(given.shape))
    stiffness = given_stiffness(known, baseline)
    # What is smooth over more pixels than some steps without coarser grids reach is left as it was given.
    height = median_of(given)
    for _ in range(_ROUNDS):
        data = DataTerm(stiffness, stiffness * (given - height))
        height = most_probable(height, data, cut, prior, steps=_STEPS, levels=0)
        prior = smoothness_by_evidence(height, stiffness, cut, prior, table)
    return SmoothedHeights(height, stiffness, cut, prior)


def given_stiffness(known: BoolArray, baseline: float) -> FloatArray:
    """Return the stiffness (H, W) with which given heights are held."""
    return np.where(known, (baseline / GIVEN_NOISE_PX) ** 2 / _GIVEN_CORRELATED, 0.0)


def without_spikes(height: FloatArray, limit: float) -> FloatArray:
    """Replace what stands out of its 5 x 5 px by more than `limit`: narrower than the beam and so no shape.

    Examples
    --------
    >>> spike = np.zeros((7, 7))
    >>> spike[3, 3] = 9.0
    >>> float(without_spikes(spike, 2.0).max())
    0.0
    """
    median = median_of(height)
    return np.where(np.abs(height - median) > limit, median, height)


def median_of(height: FloatArray) -> FloatArray:
    """Return the median of each 5 x 5 px of heights (H, W), none of them NaN."""
    return np.asarray(cv2.medianBlur(height.astype(np.float32), _SPIKE_PX), np.float64)


def near_jumps(height: FloatArray, limit: float, reach_px: int) -> BoolArray:
    """Return where heights (H, W), none of them NaN, step by more than the limit within so many px.

    Examples
    --------
    >>> wall = np.where(np.arange(10) < 5, 0.0, 8.0) * np.ones((10, 1))
    >>> near_jumps(wall, 1.0, 2)[5].astype(int)
    array([0, 0, 0, 1, 1, 1, 1, 1, 0, 0])
    """
    jump = np.zeros(height.shape, np.uint8)
    jump[:, 1:] |= np.abs(np.diff(height, axis=1)) > limit
    jump[1:] |= np.abs(np.diff(height, axis=0)) > limit
    side = 2 * reach_px + 1
    near: BoolArray = cv2.dilate(jump, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
    return near
