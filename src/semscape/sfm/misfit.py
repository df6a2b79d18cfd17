"""A view that does not fit the others: a moved or charged specimen, or another one."""

from __future__ import annotations

import numpy as np

from semscape.options import SfmOptions
from semscape.sfm.adjust import adjust, with_translations
from semscape.sfm.evolve import search
from semscape.sfm.priors import motion_prior
from semscape.types import FloatArray, Observations, TiltSeries

_LEAST_VIEWS = 4
_SUSPICIOUS_SHARE = 0.2
_SUSPICIOUS_RATIO = 1.5
_BETTER_WITHOUT = 1.3


def misfitting_view(
    series: TiltSeries,
    observations: Observations,
    kept: Observations,
    residual_px: FloatArray,
    options: SfmOptions,
    *,
    rng: np.random.Generator,
) -> int | None:
    """Return the view without which the others fit clearly better, None where all fit.

    Only where a view has lost a fifth of its observations, and half as many again as the usual view, or has
    residuals half as large again, is each view left out in turn and the motion of the others searched anew. With fewer
    than four views nobody can say which one is wrong.

    Parameters
    ----------
    series : TiltSeries
    observations : Observations
        All tracks.
    kept, residual_px : Observations and (K, 2) float array
        What calibration kept of them, and its residuals.
    options : SfmOptions
    rng : numpy.random.Generator
    """
    views = series.n_views
    if views < _LEAST_VIEWS:
        return None
    all_of_view = np.maximum(np.bincount(observations.view, minlength=views), 1)
    lost = 1 - np.bincount(kept.view, minlength=views) / all_of_view
    rms = np.sqrt([np.median((residual_px[kept.view == view] ** 2).sum(axis=1)) for view in range(views)])
    suspicious = (lost > _SUSPICIOUS_SHARE) & (lost > _SUSPICIOUS_RATIO * np.median(lost))
    if not (suspicious | (rms > _SUSPICIOUS_RATIO * np.median(rms))).any():
        return None
    noise_px = np.array([_noise_without(view, series, observations, options, rng) for view in range(views)])
    worst = int(np.argmin(noise_px))
    return worst if noise_px[worst] * _BETTER_WITHOUT < np.median(np.delete(noise_px, worst)) else None


def without_view(observations: Observations, view: int) -> Observations:
    """Return the tracks of the other views, those that two of them still see, with views and points numbered anew."""
    keep = observations.view != view
    count = np.bincount(observations.point[keep], minlength=observations.n_points)
    keep &= count[observations.point] >= 2
    _, point = np.unique(observations.point[keep], return_inverse=True)
    left = observations.view[keep]
    return Observations(left - (left > view), point.astype(np.int64), observations.xy[keep])


def _noise_without(
    view: int, series: TiltSeries, observations: Observations, options: SfmOptions, rng: np.random.Generator
) -> float:
    others = series.select(tuple(index for index in range(series.n_views) if index != view), "")
    left = without_view(observations, view)
    if not left.n_points:
        return np.inf
    prior = motion_prior(others, options)
    start = with_translations(search(left, prior, options, rng=rng).evolution.parameters, left, others.n_views)
    return adjust(start, left, prior, max_iterations=options.max_iterations).sigma_px
