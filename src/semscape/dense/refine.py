"""Multi-view refinement of a height map: move every height so that all views agree.

With the current heights every view is resampled into the grid. Where the heights are right all resampled
views show the same texture up to gain and offset; the difference, against how the texture changes with
height, gives the correction by least squares over a Gaussian window (Lucas & Kanade 1981, over all views and
in one unknown). The window follows the surface, because each of its pixels is resampled at its own height.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.dense.consistency import compare_views
from semscape.dense.sampling import ViewSampler, common_parallax, gaussian_window
from semscape.dense.smooth import local_plane_heights
from semscape.dense.stereo import filled_from_nearest, without_speckles
from semscape.options import DenseOptions
from semscape.types import BoolArray, FloatArray, ImageArray, Micrograph

# Windows from narrow to wide, in units of the narrowest; a pixel keeps the narrowest one whose disparity is sharp
# to the limit beside it, px.
_WINDOW_SCALES = (1.0, 1.8, 3.2)
_SHARP_PX = (0.4, 0.4, 0.5)
_DETAIL_SHARE = 0.5
_MAX_STEP_PX = 0.5
_MAX_TOTAL_PX = 1.0
_START_NOISE_PX = 0.6
_MEDIAN_PX = 5
# Patches smaller than this, and than this share of the field, that stand alone are chance agreements of noise.
_ISLAND_AREA_PX = 200
_ISLAND_SHARE = 3e-4
# Blur of the images, for the narrowest window; it grows with the window, for white noise falls with it.
_PRESMOOTH_PX = 0.5
# Gain and offset are taken out over this neighbourhood: shading that changes with tilt is smooth beside texture.
_NORMALIZING_SIGMA_PX = 2.5
_PAIR_INFLATION = 4.0


@dataclass(frozen=True)
class RefinedHeights:
    """Heights (H, W) with their 1-sigma uncertainty in the same unit, and the number of agreeing views."""

    height: FloatArray
    uncertainty: FloatArray
    n_views: NDArray[np.uint8]


def refine_heights(
    height: FloatArray,
    views: tuple[Micrograph, ...],
    view_from_grid: FloatArray,
    px_per_height: FloatArray,
    options: DenseOptions,
) -> RefinedHeights:
    """Refine the heights of a grid over all views.

    Parameters
    ----------
    height : (H, W) float array
        Start, NaN where unknown; those stay unknown.
    views : V Micrographs
    view_from_grid : (V, 2, 3) float array
        View px of grid (col, row, 1) at height zero.
    px_per_height : (V, 2) float array
        Shift in each view per unit of height.
    options : DenseOptions
        Window (sigma in px) and iterations.

    References
    ----------
    Lucas & Kanade 1981 (IJCAI); Furukawa & Ponce 2010, doi:10.1109/TPAMI.2009.161.
    """
    known = np.isfinite(height)
    start = filled_from_nearest(height)
    direction, parallax = common_parallax(px_per_height)
    baseline = float(np.ptp(parallax))
    limit = _MAX_STEP_PX / baseline
    chosen = np.full(height.shape, np.nan)
    variance = np.full(height.shape, np.nan)
    n_views = np.zeros(height.shape)
    at_start = np.zeros(height.shape)
    narrower: FloatArray | None = None
    current = start
    for scale, sharp_px in zip(_WINDOW_SCALES, _SHARP_PX, strict=True):
        sigma_px, normalizing_px = scale * options.refine_sigma_px, scale * _NORMALIZING_SIGMA_PX
        samplers: list[ViewSampler] = []  # those of the window before go first, for they are the most memory
        samplers = [
            ViewSampler(view, view_from_grid[i], px_per_height[i], direction, height.shape, scale * _PRESMOOTH_PX)
            for i, view in enumerate(views)
        ]
        state = _compare(start, known, samplers, parallax, sigma_px, normalizing_px)
        at_start = np.maximum(at_start, state.n_views)
        for _ in range(options.refine_iterations):
            if current is not start:
                state = _compare(current, known, samplers, parallax, sigma_px, normalizing_px)
            current = np.where(known, np.clip(state.height, current - limit, current + limit), start)
        take = known & np.isnan(chosen) & (state.n_views >= 2) & (np.sqrt(state.variance) * baseline <= sharp_px)
        take &= np.abs(current - start) * baseline <= _MAX_TOTAL_PX
        if narrower is not None:
            # What each wider window smooths away tells how much the chosen one does: shape finer than the window is an
            # error that no scatter of the views shows.
            detail = gaussian_window(((current - narrower) ** 2 * known).astype(np.float32), sigma_px).astype(
                np.float64
            )
            variance += _DETAIL_SHARE * detail
        narrower = current
        chosen, variance = np.where(take, current, chosen), np.where(take, state.variance, variance)
        n_views = np.where(take, state.n_views, n_views)
    # At depth jumps a window holds two surfaces and its plane neither; there the pairs' own answer stands, if the
    # views agree on it.
    stays = known & np.isnan(chosen) & (at_start >= 2)
    median = cv2.medianBlur(start.astype(np.float32), _MEDIAN_PX).astype(np.float64)
    chosen, n_views = np.where(stays, median, chosen), np.where(stays, at_start, n_views)
    variance = np.where(stays, (_START_NOISE_PX / baseline) ** 2, variance)
    chosen = without_islands(chosen, baseline)
    found = np.isfinite(chosen)
    return RefinedHeights(
        chosen, np.where(found, np.sqrt(variance), np.nan), np.where(found, n_views, 0).astype(np.uint8)
    )


def without_islands(height: FloatArray, baseline: float) -> FloatArray:
    """Drop small patches of heights (H, W) that jumps cut off from the rest."""
    island_px = max(_ISLAND_AREA_PX, int(_ISLAND_SHARE * height.size))
    return without_speckles(height * baseline, island_px) / baseline


@dataclass(frozen=True)
class _Comparison:
    height: FloatArray
    variance: FloatArray
    n_views: FloatArray


def _compare(
    height: FloatArray,
    known: BoolArray,
    samplers: list[ViewSampler],
    parallax: FloatArray,
    sigma_px: float,
    normalizing_px: float,
) -> _Comparison:
    """Linearize the disagreement of the views about the current heights."""
    count = len(samplers)
    seen = compare_views(height, known, samplers, parallax, normalizing_px)
    surface = known.astype(np.float32)
    total, slope, leverage, weights = seen.total, seen.slope, seen.leverage, seen.weights
    force = np.zeros(height.shape, np.float32)
    spread = np.zeros(height.shape, np.float32)
    misfit = np.zeros(height.shape, np.float32)
    for i in range(count):
        residual = seen.values[i] - seen.template
        pull = seen.pull(i)
        force += pull
        spread += gaussian_window(pull, sigma_px) ** 2
        misfit += weights[i] * residual * residual
    stiffness = (slope * slope * leverage).astype(np.float32)
    base = _base(height, surface, sigma_px)
    offset = np.where(known, height - base, 0.0).astype(np.float32)
    fitted = base + local_plane_heights(stiffness, stiffness * offset - force, sigma_px)

    plain = gaussian_window(stiffness, sigma_px)
    texture = gaussian_window(seen.texture(), sigma_px)
    texture = np.maximum(np.maximum(texture, 0.2 * plain), 1e-9).astype(np.float64)
    per_view = (misfit / np.maximum(total - 1, 0.25)).astype(np.float32)
    noise = gaussian_window(per_view, sigma_px).astype(np.float64)
    variance = noise / (texture * 4 * np.pi * sigma_px**2)
    if count > 2:
        # What the views' separate pulls scatter, correlations between neighbouring pixels included.
        scattered = gaussian_window(spread, 2 * sigma_px).astype(np.float64) * count / (count - 2) / texture**2
        variance = np.maximum(variance, scattered)
    else:
        variance *= _PAIR_INFLATION
    return _Comparison(fitted, variance, (weights > 0.5).sum(axis=0).astype(np.float64))


def _base(height: FloatArray, surface: ImageArray, sigma_px: float) -> FloatArray:
    """Return a smooth version of the known heights, so that single precision serves for what is left."""
    smooth = cv2.GaussianBlur(np.where(surface > 0, height, 0.0), (0, 0), 2 * sigma_px)
    coverage = cv2.GaussianBlur(surface, (0, 0), 2 * sigma_px).astype(np.float64)
    return np.where(coverage > 1e-3, smooth / np.maximum(coverage, 1e-3), height)
