"""Wrong matches that lie on their epipolar line by chance: told by a parallax far from that of the others.

The distance to a line cannot tell them. But the relief of a specimen is bounded, and so is the parallax: along the
lines all right matches lie within some L of one affine map of the image. A match at random falls into the rectangle of
2 t by 2 L about its predicted place with probability 4 t L / A. t and L are those of least NFA: no limit is given.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from semscape.robust.models import AFFINE, Shape
from semscape.robust.score import least_nfa, log10_combinations
from semscape.robust.search import RobustFit
from semscape.types import BoolArray, FloatArray

_TRIMMINGS = 10
_N_LIMITS = 60
_LEAST_LIMIT_PX = 2.0


def limit_parallax(fit: RobustFit, x1: FloatArray, x2: FloatArray, shapes: tuple[Shape, Shape]) -> RobustFit:
    """Return an affine fit without the inliers whose parallax stands out, its thresholds chosen anew.

    It pays where most putative matches are wrong. A few right matches far above or below all others (the tip of a
    needle) are lost with the wrong ones, so nothing does this unasked.

    Parameters
    ----------
    fit : RobustFit
        Of kind "affine", from these matches.
    x1, x2 : (M, 2) float arrays
        Matched points in px.
    shapes : ((int, int), (int, int))
        Height and width of the two images in px.

    Returns
    -------
    RobustFit
        The same model; inliers are within `threshold_px` of their lines and within the limit of parallax. The fit
        itself where no limit lowers its NFA.

    Raises
    ------
    ValueError
        For another kind of model.

    Examples
    --------
    >>> from semscape.robust.acransac import ac_ransac
    >>> rng = np.random.default_rng(0)
    >>> x1 = rng.uniform(0, 1000, (500, 2))
    >>> x2 = x1 + np.column_stack([rng.uniform(-9, 9, 500), rng.normal(0, 2, 500)])
    >>> x2[:400] = rng.uniform(0, 1000, (400, 2))
    >>> shapes = ((1000, 1000), (1000, 1000))
    >>> found = ac_ransac(AFFINE, x1, x2, shapes=shapes, rng=rng, max_trials=10_000)
    >>> limited = limit_parallax(found, x1, x2, shapes)
    >>> bool(found.inliers[:400].sum() > 2), bool(limited.inliers[:400].sum() <= 2)
    (True, True)
    """
    if fit.kind != "affine":
        raise ValueError(f"the parallax is limited along affine epipolar lines, not for the model {fit.kind!r}")
    if np.count_nonzero(fit.inliers) <= AFFINE.sample_size:
        return fit
    off_px = _off_the_trend(fit, x1, x2)
    finite = np.flatnonzero(np.isfinite(off_px) & np.isfinite(fit.residual_px))
    _, first = np.unique(np.hstack([x1, x2])[finite], axis=0, return_index=True)
    distinct = finite[first]
    table = log10_combinations(len(distinct), AFFINE.sample_size, _N_LIMITS)
    best, best_limit = fit, math.inf
    for limit in np.geomspace(_LEAST_LIMIT_PX, max(shapes[1]), _N_LIMITS):
        log_alpha0 = math.log10(4 * limit / math.prod(shapes[1]))
        residual = np.where(off_px[distinct] <= limit, fit.residual_px[distinct], math.inf)
        log10_nfa, threshold = least_nfa(residual, table, log_alpha0, AFFINE.sample_size, 1)
        if log10_nfa < best.log10_nfa:
            best, best_limit = replace(fit, log10_nfa=log10_nfa, threshold_px=threshold), limit
    return replace(best, inliers=(fit.residual_px <= best.threshold_px) & (off_px <= best_limit))


def _off_the_trend(fit: RobustFit, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return how far (M,) each match lies along its line from the affine map of most inliers, in px."""
    a, b = fit.matrix[:2, 2]
    along = (x2 - x1) @ np.array([-b, a]) / math.hypot(a, b)
    design = np.column_stack([x1, np.ones(len(x1))])
    off = np.zeros(len(x1))
    kept: BoolArray = fit.inliers
    for _ in range(_TRIMMINGS):
        trend = np.linalg.lstsq(design[kept], along[kept], rcond=None)[0]
        off = np.abs(along - design @ trend)
        kept = fit.inliers & (off <= 3 * np.median(off[kept]))
    return off
