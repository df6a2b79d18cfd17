"""The last step: the most probable surface under all views, its smoothness by evidence, its uncertainty.

First the heights given are smoothed as far as they say that the surface is smooth. Then every view is resampled at
these heights, and what the views disagree pulls each height by its noise, round by round. Beside depth jumps the
views' windows hold two surfaces; there the heights given stay the data.

The noise is what the views show of it. Of what each of V views says about its own shift, a height explains one
direction and the texture another; the V - 2 that are left are noise, in windows as wide as the surface averages over:
blur and jitter make neighbours err alike. What drift shifts far and wide counts for itself.

What parallax leaves to noise, brightness may tell, where it follows the surface's slopes (`dense.shading`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from semscape.dense.consistency import ComparedViews, compare_looks, compare_views, look_through
from semscape.dense.given import GIVEN_NOISE_PX, JUMP_PX, given_stiffness, smoothed, without_spikes
from semscape.dense.lateral import half_passing_period, stated_period
from semscape.dense.posterior import (
    DataTerm,
    Smoothness,
    averaging_width,
    height_variance,
    lattice_table,
    most_probable,
    passing_period,
    smoothness_by_evidence,
    smoothness_cut,
)
from semscape.dense.sampling import gaussian_window
from semscape.dense.shading import ShadingLaws, Texture
from semscape.dense.side_by_side import Mapper
from semscape.dense.slopes import SlopeTerm
from semscape.dense.stereo import filled_from_nearest, without_speckles
from semscape.dense.sweep import Views
from semscape.types import BoolArray, FloatArray, ImageArray

_ROUNDS = 3
# Gain and offset are taken out over this neighbourhood: shading that changes with tilt is smooth beside texture.
_NORMALIZING_PX = 2.5
# Views that agree are counted over this one.
_AGREEMENT_PX = 6.0
_NOISE_PX = 6.0
# Windows in which the scatter of the views' pulls is compared with that of independent pixels.
_WIDTHS_PX = (1.5, 3.0, 6.0, 12.0)
_ALL_AGREE = 0.5
_LEAST_SAMPLE = 1000
_SAMPLED_PX = 2
SPECK_PX = 5
_MAX_STEP_PX = 0.5
# Beside a jump: how far the views' windows reach, and over what they are asked again.
_BESIDE_PX = 6
_PLACE_PX = 1.5
_CREASE_PX = 2.0
# With two views nothing tells how their pulls scatter.
_PAIR_INFLATION = 4.0
# Two neighbours of many views err by ten times what all do, or more: then nobody measures by them.
_MOST_SHARE = 100.0
# Patches smaller than this, and than this share of the field, that stand alone are chance agreements of noise.
_ISLAND_AREA_PX = 200
_ISLAND_SHARE = 3e-4


@dataclass(frozen=True, eq=False)
class Begun:
    """Heights to start from (H, W), px: which are `known`, as `given`, and smoothed.

    `variance` and `weight` are those of their smoothness.
    """

    known: BoolArray
    given: ImageArray
    height: ImageArray
    variance: ImageArray
    weight: ImageArray


@dataclass(frozen=True)
class RefinedHeights:
    """Heights (H, W) with their 1-sigma uncertainty in the same unit, and the number of agreeing views.

    `lateral_period_px` (H, W) is the period of the wave that they hold with half its height. `slow_variance` is the
    part of every variance that is shared far and wide, `slow_share` (H, W) how many times more of it each height holds:
    1 where all views agree, more where fewer do.
    """

    height: FloatArray
    uncertainty: FloatArray
    n_views: NDArray[np.uint8]
    lateral_period_px: ImageArray
    slow_variance: float
    slow_share: ImageArray


@dataclass(frozen=True)
class _Noise:
    """What the views say about their noise.

    `variance` (H, W) of one pixel's grey value; `inflation`, how many times more the views' shifts scatter, in each of
    the windows, than independent pixels would; and `slow`, the variance of a height, px^2, that is shared far and wide.
    """

    variance: FloatArray
    inflation: list[float]
    slow: float


def begin(start: FloatArray, baseline: float) -> Begun:
    """Smooth heights (H, W), in px, crisp at jumps, NaN where unknown, as far as they say that the surface is smooth.

    Specks of a few unknown pixels far from jumps are tried from their neighbours; what else is unknown stays so.
    """
    start = without_islands(start, baseline)
    known = np.isfinite(start)
    if not known.any():
        none = np.zeros(start.shape, np.float32)
        return Begun(known, none, none, none, none)
    given = without_spikes(filled_from_nearest(start), JUMP_PX / baseline)
    known |= specks(~known) & ~_spans(given, 2 * JUMP_PX / baseline)
    first = smoothed(given, known, baseline, lattice_table())
    planes = (each.astype(np.float32) for each in (given, first.height, first.prior.variance, first.prior.weight))
    return Begun(known, *planes)


def refine_by_evidence(
    begun: Begun, views: Views, calm: Views, laws: ShadingLaws | None = None, *, mapper: Mapper = map
) -> RefinedHeights:
    """Return the most probable heights near the given ones, in px, with their 1-sigma uncertainty.

    Parameters
    ----------
    begun : Begun
        Where no two views agree, heights are unknown in the end.
    views : Views
    calm : Views
        The same, smoothed more against noise: of these is asked whether they agree.
    laws : ShadingLaws
        How brightness follows slopes; where left out, it is not asked.
    mapper : callable
        `map`, or one that runs parts side by side; the result does not depend on it.

    References
    ----------
    MacKay 1992, doi:10.1162/neco.1992.4.3.415; Lucas & Kanade 1981 (IJCAI).
    """
    known, base = begun.known, views.baseline
    given, height = (np.asarray(each, np.float64) for each in (begun.given, begun.height))
    if not known.any():
        nothing = np.full(known.shape, np.nan)
        flat = nothing.astype(np.float32)
        return RefinedHeights(nothing, nothing, np.zeros(known.shape, np.uint8), flat, 0.0, flat)
    table = lattice_table()
    held = given_stiffness(known, base)
    cut = smoothness_cut(np.where(known, given, np.nan), JUMP_PX / base)
    prior = Smoothness(np.asarray(begun.variance, np.float64), np.asarray(begun.weight, np.float64))
    stiffness = held
    beside = _beside_jumps(np.where(known, height, np.nan), JUMP_PX / base)
    free = np.asarray(known & ~beside, np.float32)
    texture = Texture()
    for _ in range(_ROUNDS):
        looks = list(mapper(partial(look_through, height), views.samplers))
        terms: list[SlopeTerm] = []
        if laws is not None:
            terms, looks = laws.heard(looks, views.parallax, free, height, texture)
        slopes = np.asarray(sum(term.slope_precision() for term in terms), np.float64) if terms else None
        width = np.clip(averaging_width(stiffness, known, prior, table), _WIDTHS_PX[0], _WIDTHS_PX[-1])
        seen = compare_looks(looks, known, views.parallax, _NORMALIZING_PX, mapper=mapper)
        noise = _noise(seen, known, views.parallax, mapper)
        divisor = noise.variance * np.exp(np.interp(np.log(width), np.log(_WIDTHS_PX), np.log(noise.inflation)))
        sharpness = known * seen.slope**2 * seen.leverage
        pull = -1.0 * known * sum(seen.pull(i) for i in range(len(views.samplers)))
        stiffness = np.where(beside, held, sharpness / divisor)
        data = DataTerm(stiffness, np.where(beside, held * (given - height), pull / divisor))
        moved = most_probable(height, data, cut, prior, terms)
        height = np.clip(moved, height - _MAX_STEP_PX / base, height + _MAX_STEP_PX / base)
        prior = smoothness_by_evidence(height, stiffness, cut, prior, table, slopes)
    agreed = compare_views(height, known, calm.samplers, calm.parallax, _AGREEMENT_PX, mapper=mapper).weights
    agreeing = agreed > _ALL_AGREE
    share = _slow_share(agreeing, views.parallax)
    variance = height_variance(stiffness, known, prior, table, slopes) + noise.slow * share
    # What the smoothness takes from a crease its variance, that of the neighbourhood, does not tell: about as much as
    # it would take from the heights found once more.
    still = [term.at_rest() for term in terms]
    again = most_probable(height, DataTerm(stiffness, np.zeros_like(height)), cut, prior, still)
    taken = gaussian_window(((height - again) ** 2).astype(np.float32), _CREASE_PX)
    at_jump = np.maximum(variance, (GIVEN_NOISE_PX / base) ** 2) + _wanted_shift(pull, sharpness) ** 2
    variance = np.where(beside, at_jump, variance + taken)
    n_views = agreeing.sum(axis=0)
    period = half_passing_period(averaging_width(stiffness, known, prior, table))
    if slopes is not None:
        period = np.minimum(period, stated_period(passing_period(stiffness, known, prior, table, slopes)))
    found = np.isfinite(without_islands(np.where(known & (n_views >= 2), height, np.nan), base))
    return RefinedHeights(
        np.where(found, height, np.nan),
        np.where(found, np.sqrt(variance), np.nan),
        np.where(found, n_views, 0).astype(np.uint8),
        np.where(found, period, np.float32(np.nan)),
        noise.slow,
        np.where(found, share, np.nan).astype(np.float32),
    )


def without_islands(height: FloatArray, baseline: float) -> FloatArray:
    """Drop small patches of heights (H, W) that jumps cut off from the rest."""
    island_px = max(_ISLAND_AREA_PX, int(_ISLAND_SHARE * height.size))
    return without_speckles(height * baseline, island_px) / baseline


def specks(unknown: BoolArray) -> BoolArray:
    """Return what of the unknown pixels (H, W) holds no square of 5 x 5 px."""
    square = np.ones((SPECK_PX, SPECK_PX), np.uint8)
    small: BoolArray = unknown & (cv2.morphologyEx(unknown.astype(np.uint8), cv2.MORPH_OPEN, square) == 0)
    return small


def _spans(height: FloatArray, limit: float) -> BoolArray:
    """Return where heights (H, W) span more than `limit` over 5 x 5 px: beside a jump the unknown is hidden ground."""
    square = np.ones((SPECK_PX, SPECK_PX), np.uint8)
    spans: BoolArray = cv2.dilate(height, square) - cv2.erode(height, square) > limit
    return spans


def _noise(seen: ComparedViews, known: BoolArray, parallax: FloatArray, mapper: Mapper) -> _Noise:
    count = len(seen.values)
    residual = seen.weights * (seen.values - seen.template)
    # Shading that changes as the specimen tilts looks like a height, so noise is taken in that direction; a pixel
    # has little part in its own height.
    along = (seen.lever * residual).sum(axis=0) ** 2 / np.maximum(seen.leverage, np.float32(1e-9))
    variance = np.maximum(gaussian_window(along.astype(np.float32), _NOISE_PX), np.float32(1e-3))
    if count == 2:
        return _Noise(variance.astype(np.float64), [_PAIR_INFLATION] * len(_WIDTHS_PX), 0.0)
    good = known & (seen.weights.min(axis=0) > _ALL_AGREE)
    good = good if good.sum() > _LEAST_SAMPLE else known
    explained = np.column_stack([np.ones(count), parallax])
    unexplained = np.eye(count) - explained @ np.linalg.pinv(explained)
    alone = np.maximum(gaussian_window((residual**2).sum(axis=0) / (count - 1), _NOISE_PX), np.float32(1e-3))
    freedom = count - 2
    # The median of a mean of squares lies below the mean.
    median = chi2.ppf(0.5, freedom) / freedom
    # Neighbours say nearly the same: a part of the pixels is enough.
    sample = np.ix_(*(np.arange(1, size, _SAMPLED_PX) for size in known.shape))
    used = good[sample]
    power = np.asarray(seen.slope**2, np.float32)
    shifts = [np.asarray(seen.slope * view, np.float32) for view in residual]
    alone = np.asarray(alone * power, np.float32)
    scatters = list(mapper(partial(_scatter, shifts, unexplained, used), _WIDTHS_PX))
    inflation = []
    for width, scatter in zip(_WIDTHS_PX, scatters, strict=True):
        independent = gaussian_window(alone, width / np.sqrt(2.0))[sample][used] / (4 * np.pi * width**2)
        inflation.append(max(float(np.median(scatter / np.maximum(independent, 1e-12)) / median), 1.0))
    texture = np.maximum(gaussian_window(power, _WIDTHS_PX[-1])[sample][used], 1e-9)
    leverage = float(((parallax - parallax.mean()) ** 2).sum())
    slow = float(np.median(scatters[-1] / texture**2) / median) / leverage
    # A shift that all pixels of a window share grows with the window's area beside independent noise. No smoothing
    # lowers it, so it must not ask for any.
    narrow, wide = _WIDTHS_PX[1] ** 2, _WIDTHS_PX[-1] ** 2
    shared = max(inflation[-1] - inflation[1], 0.0) / (wide - narrow)
    own = [max(total - shared * width**2, 1.0) for total, width in zip(inflation, _WIDTHS_PX, strict=True)]
    return _Noise(variance.astype(np.float64), own, slow * shared * wide / inflation[-1])


def _slow_share(agreeing: BoolArray, parallax: FloatArray) -> FloatArray:
    """Return how many times more drift makes of a height (H, W) where not all views (V, H, W) agree: their baseline."""
    g = parallax[:, None, None]
    mean = (agreeing * g).sum(axis=0) / np.maximum(agreeing.sum(axis=0), 1)
    leverage = (agreeing * (g - mean) ** 2).sum(axis=0)
    of_all = float(((parallax - parallax.mean()) ** 2).sum())
    return np.asarray(of_all / np.maximum(leverage, of_all / _MOST_SHARE), np.float64)


def _scatter(shifts: list[ImageArray], unexplained: FloatArray, used: BoolArray, width_px: float) -> FloatArray:
    """Return how far shifts, each the mean over a window, scatter beside what heights and texture explain."""
    sample = np.ix_(*(np.arange(1, size, _SAMPLED_PX) for size in shifts[0].shape))
    scattered = np.stack([gaussian_window(shift, width_px)[sample][used] for shift in shifts])
    return np.asarray(((unexplained @ scattered) ** 2).sum(axis=0) / (len(shifts) - 2), np.float64)


def _wanted_shift(pull: NDArray[np.floating], sharpness: NDArray[np.floating]) -> FloatArray:
    """Return how far the views around would move heights (H, W) that are held."""
    force = gaussian_window(pull.astype(np.float32), _PLACE_PX)
    sharp = np.maximum(gaussian_window(sharpness.astype(np.float32), _PLACE_PX), np.float32(1e-9))
    return np.asarray(force / sharp, np.float64)


def _beside_jumps(height: FloatArray, limit: float) -> BoolArray:
    """Return where a step beyond `limit` lies within 6 px."""
    jump = np.zeros(height.shape, np.uint8)
    with np.errstate(invalid="ignore"):
        along = np.abs(np.diff(height, axis=1)) > limit
        down = np.abs(np.diff(height, axis=0)) > limit
    jump[:, 1:] |= along
    jump[:, :-1] |= along
    jump[1:] |= down
    jump[:-1] |= down
    side = 2 * _BESIDE_PX + 1
    beside: BoolArray = cv2.dilate(jump, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
    return beside
