"""Vote on the sign of a self-calibrated relief by its shading.

Parallel projections of a relief and of its mirror image under opposite tilts are the same. Secondary
electrons tell them apart: they leave ridges and small bumps easily and pits hardly, so what stands out of its
neighbourhood is bright.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from scipy.stats import rankdata

from semscape.errors import BadInputError
from semscape.options import SfmOptions
from semscape.sfm.priors import MotionPrior
from semscape.types import Ambiguity, FloatArray, Micrograph, Observations, TiltSeries

_NEIGHBOURS = 30
_FINE_PX = 3.0
_LEAST_COARSE_PX = 8.0
# Shading is a rule with exceptions, however many neighbourhoods agree.
_MOST_CONFIDENT = 0.99
_CERTAIN_VOTE = 0.98


class ReliefSign(NamedTuple):
    """Whether the relief is to be mirrored (`sign` -1), how sure that is, and what to say of it."""

    sign: float
    ambiguity: Ambiguity
    confidence: float
    warnings: list[str]


def relief_vote(view: Micrograph, xy: FloatArray, height: FloatArray) -> tuple[float, float]:
    """Correlate local height with local brightness.

    Local height is the height above the plane through the 30 nearest points; local brightness is taken
    against the wider neighbourhood. The slope, which brightens a surface whatever its sign, is regressed out.

    Parameters
    ----------
    view : Micrograph
        The view that `xy` refers to.
    xy : (P, 2) float array
        Points in px.
    height : (P,) float array
        Heights in any unit.

    Returns
    -------
    correlation : float
        Rank correlation in [-1, 1]; negative when the relief is inverted.
    confidence : float
        Probability in [0.5, 1) that its sign is right, with one independent vote per neighbourhood.
    """
    if len(xy) < 2 * _NEIGHBOURS or not np.ptp(view.image[view.mask]):
        return 0.0, 0.5
    distance, neighbour = cKDTree(xy).query(xy, k=_NEIGHBOURS)
    radius = distance[:, -1]
    offset = np.concatenate([xy[neighbour] - xy[:, None], np.ones((len(xy), _NEIGHBOURS, 1))], axis=2)
    normal = np.einsum("nki,nkj->nij", offset, offset) + 1e-6 * np.eye(3)
    right = np.einsum("nki,nk->ni", offset, height[neighbour])
    plane = np.linalg.solve(normal, right[..., None])[..., 0]
    local_height = height - plane[:, 2]
    slope = np.hypot(plane[:, 0], plane[:, 1])

    weight = view.mask.astype(np.float64)
    filled = np.where(view.mask, view.image, float(view.image[view.mask].mean()))
    coarse = max(_LEAST_COARSE_PX, 1.5 * float(distance.mean()))
    local_brightness = (gaussian_filter(filled, _FINE_PX) - gaussian_filter(filled, coarse)) * weight
    rows = np.clip(np.rint(xy[:, 1]).astype(int), 0, view.image.shape[0] - 1)
    cols = np.clip(np.rint(xy[:, 0]).astype(int), 0, view.image.shape[1] - 1)

    dense = radius <= np.percentile(radius, 80)
    brightness = _centred_ranks(local_brightness[rows, cols][dense])
    explaining = np.column_stack([_centred_ranks(local_height[dense]), _centred_ranks(slope[dense])])
    coefficient, *_ = np.linalg.lstsq(explaining, brightness, rcond=None)
    correlation = float(coefficient[0])
    votes = dense.sum() / _NEIGHBOURS
    confidence = min(0.5 * (1 + math.erf(abs(correlation) * math.sqrt(votes) / math.sqrt(2))), _MOST_CONFIDENT)
    return correlation, confidence


def relief_sign(
    series: TiltSeries,
    observations: Observations,
    points: FloatArray,
    prior: MotionPrior,
    options: SfmOptions,
) -> ReliefSign:
    """Decide whether to mirror the relief: by the stage's sign, else by shading, reported as assumed.

    Raises
    ------
    BadInputError
        Where the relief is to be inverted although the stage fixes its sign.
    """
    if not prior.self_calibrated and options.invert_relief:
        raise BadInputError(
            "--invert-relief is for series without stage tilts; here the sign of the tilts fixes the relief. "
            "If the relief is inverted, give the tilts with the opposite signs (--tilts)"
        )
    in_reference = observations.view == prior.reference
    seen = observations.point[in_reference]
    correlation, confidence = relief_vote(series.views[prior.reference], observations.xy[in_reference], points[seen, 2])
    if not prior.self_calibrated:
        if correlation < 0 and confidence > _CERTAIN_VOTE:
            against = (
                f"the shading contradicts the sign of the tilts (confidence {confidence:.0%}): if hills come out as "
                "pits, give the tilts with the opposite signs (--tilts)"
            )
            return ReliefSign(1.0, "none", 1 - confidence, [against])
        return ReliefSign(1.0, "none", 1.0, [])
    sign = -1.0 if correlation < 0 else 1.0
    voted = (
        "no stage tilt gives the sign of the relief: shading votes for what is bright to stand up, confidence "
        f"{confidence:.0%}"
    )
    if options.invert_relief:
        turned = f"{voted}; --invert-relief turns it against that vote: if hills come out as pits, run without it"
        return ReliefSign(-sign, "reflection", 1 - confidence, [turned])
    assumed = f"{voted}; if hills come out as pits, run again with --invert-relief"
    return ReliefSign(sign, "reflection", confidence, [assumed])


def _centred_ranks(values: FloatArray) -> FloatArray:
    ranks: FloatArray = (rankdata(values) - (len(values) + 1) / 2) / len(values)
    return ranks
