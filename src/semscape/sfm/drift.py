"""Slow drift of the scan: a smooth shift of each view's rows, from one end of the frame to the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from semscape.sfm.adjust import Adjustment
from semscape.sfm.noise import free_share
from semscape.types import FloatArray, Observations

_ROUNDS = 5
_LEAST_PER_TERM = 10
_WEAK_PRIOR = 1e-3


@dataclass(frozen=True)
class ScanDrift:
    """Legendre coefficients (V, D, 2) px from the first degree on, over the rows 0 to `height_px` - 1."""

    coefficients_px: FloatArray
    height_px: int

    def at(self, observations: Observations) -> FloatArray:
        """Return the shift (K, 2) px of each observation."""
        terms = _terms(observations.xy[:, 1], self.height_px, self.coefficients_px.shape[1])
        shift: FloatArray = np.einsum("kd,kda->ka", terms, self.coefficients_px[observations.view])
        return shift

    @property
    def rms_px(self) -> FloatArray:
        """Root mean square over the frame (V,), both coordinates together."""
        degree = np.arange(1, self.coefficients_px.shape[1] + 1)
        rms: FloatArray = np.sqrt((self.coefficients_px**2 / (2 * degree + 1)[:, None]).sum(axis=(1, 2)))
        return rms


def fit_drift(
    first: Adjustment,
    observations: Observations,
    refit: Callable[[FloatArray, Observations], Adjustment],
    *,
    n_views: int,
    height_px: int,
    degree: int,
) -> tuple[ScanDrift, Adjustment]:
    """Find the drift from the residuals, and the adjustment without it, in turn.

    The specimen and the beam drift while a frame is scanned, a fraction of a px, so that keypoints of one region are
    shifted alike. What cameras or depth explain stays theirs, for the residuals do not show it: of the first degree
    that leaves the shear of the scan.

    Parameters
    ----------
    first : Adjustment
        To the observations as they are.
    observations : Observations
    refit : callable
        Adjusts from a start (parameters, observations).
    n_views, height_px, degree : int
        Number of views, rows of a view, highest degree of the polynomials.
    """
    drift = ScanDrift(np.zeros((n_views, degree, 2)), height_px)
    found = first
    for _ in range(_ROUNDS):
        step = _fitted(observations, found, drift, float(free_share(observations).mean()))
        drift = replace(drift, coefficients_px=drift.coefficients_px + step)
        found = refit(found.parameters, replace(observations, xy=observations.xy - drift.at(observations)))
    return drift, found


def _fitted(observations: Observations, found: Adjustment, drift: ScanDrift, share: float) -> FloatArray:
    """Return what the residuals still show of drift; the points absorb the rest of it, 1 - `share`."""
    n_views, count, _ = drift.coefficients_px.shape
    step = np.zeros_like(drift.coefficients_px)
    for view in range(n_views):
        here = observations.view == view
        if here.sum() < _LEAST_PER_TERM * count:
            continue
        xy, weight = observations.xy[here], found.weights[here]
        beside = np.column_stack([np.ones(len(xy)), (xy[:, 0] - xy[:, 0].mean()) / np.ptp(xy[:, 0])])
        design = np.column_stack([_terms(xy[:, 1], drift.height_px, count), beside])
        normal = design.T @ (weight[:, None] * design)
        normal[np.diag_indices_from(normal)] += _WEAK_PRIOR * weight.sum()
        step[view] = np.linalg.solve(normal, design.T @ (weight[:, None] * found.residual_px[here]))[:count] / share
    return step


def _terms(row: FloatArray, height_px: int, degree: int) -> FloatArray:
    return np.asarray(np.polynomial.legendre.legvander(2 * row / (height_px - 1) - 1, degree)[:, 1:], dtype=np.float64)
