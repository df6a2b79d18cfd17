"""Uncertainties of Sa, Sq, volumes and steps: which noise is drawn, on which grid.

The noise of the heights is correlated over a Gaussian window of sigma_c; where it is white, that is the window of one
pixel's area, sigma_c = 1 / sqrt(4 pi) px. The S-filter is linear and Gaussian, too, of sigma_s = 0.187 nesting indices:
behind it the noise is correlated over sqrt(sigma_c² + sigma_s²), and smaller by sigma_c over that. So the S-filtered
map is drawn upon, and no draw needs the filter.

Of a large map every k-th pixel is drawn upon. A sum over such samples has the variance of the sum over all pixels times
k² / (4 pi sigma²) where k is so large that the samples' noise is independent; sigmas are lowered by that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from semscape.errors import NoAnswerError
from semscape.metrology.areal import mean_heights
from semscape.metrology.filters import GAUSSIAN_ALPHA
from semscape.metrology.prepare import prepared_surfaces
from semscape.metrology.profile import Profile, extract_profile, sample_heights
from semscape.metrology.request import MeasureRequest
from semscape.metrology.step import Step, step_along_profile, step_between_regions
from semscape.metrology.uncertainty import Estimate, monte_carlo
from semscape.metrology.volume import volumes
from semscape.options import MeasureOptions
from semscape.types import FloatArray

_MONTE_CARLO_PIXELS = 100_000
_LEAST_KNOWN, _LEAST_SAMPLES = 10, 15
_WHITE_SIGMA_PX = 1 / math.sqrt(4 * math.pi)


@dataclass(frozen=True, eq=False)
class Errors:
    """How the heights of a map err: `uncertainty` (H, W) of each, alike over `correlation_px`, and their common scale.

    `correlation_px` is the sigma of the window that they were matched with, 0 for white noise; `scale` the relative
    sigma of the height scale, NaN = unknown.
    """

    uncertainty: FloatArray
    correlation_px: float
    scale: float


def surface_estimates(
    smooth: FloatArray, errors: Errors, spacing: float, options: MeasureOptions, *, rng: np.random.Generator
) -> dict[str, Estimate]:
    """Return Sa, Sq and the volumes with their uncertainties, by "group/name".

    Parameters
    ----------
    smooth : (H, W) float array
        The S-F surface.
    errors : Errors
        Of the heights as they were matched.
    spacing : float
        Grid spacing.
    options : MeasureOptions
        By which the surface was prepared.
    rng : numpy.random.Generator
        For the draws.

    Raises
    ------
    NoAnswerError
        If too few heights are known.
    """
    stride = max(1, math.ceil(math.sqrt(smooth.size / _MONTE_CARLO_PIXELS)))
    sigma_px, left = errors.correlation_px, 1.0
    if not math.isnan(options.s_filter_um):
        own = max(sigma_px, _WHITE_SIGMA_PX)
        sigma_px = math.hypot(own, GAUSSIAN_ALPHA / math.sqrt(2 * math.pi) * options.s_filter_um / spacing)
        left = own / sigma_px
    thinned, step = smooth[::stride, ::stride], spacing * stride
    if np.isfinite(thinned).sum() < _LEAST_KNOWN:
        raise NoAnswerError(f"{np.isfinite(smooth).sum()} heights are known in the region; choose a larger one")
    prepare = prepared_surfaces(thinned, step, replace(options, s_filter_um=math.nan), for_draws=True)

    def figures(heights: FloatArray) -> dict[str, float]:
        even, rough = prepare(heights)
        found = {f"height/{name}": value for name, value in mean_heights(rough).items()}
        contents = volumes(even, step, options.volume_level_um)
        volume = {"above": contents.above, "below": contents.below}
        return found | {f"area and volume/volume {name}": value for name, value in volume.items()}

    return monte_carlo(
        thinned,
        left * errors.uncertainty[::stride, ::stride],
        figures,
        correlation_sigma_px=sigma_px / stride,
        scale_relative_sigma=errors.scale,
        draws=options.draws,
        random_share=_random_share(sigma_px, stride),
        rng=rng,
    )


def step_estimates(
    matched: FloatArray, errors: Errors, spacing: float, request: MeasureRequest, *, rng: np.random.Generator
) -> dict[str, Estimate]:
    """Return the steps of a request with their uncertainties, by "group/name"; of the heights as they were matched.

    Between regions only what lies around them is drawn upon, with fifteen samples along their shortest side at least;
    along a profile the noise on its line.
    """
    found: dict[str, Estimate] = {}
    named: dict[str, Any] = {"scale_relative_sigma": errors.scale, "draws": request.options.draws, "rng": rng}
    if request.step is not None:
        boxes = np.array([region.box() for region in request.step])
        first = np.clip(np.floor(boxes.min(axis=(0, 1))), 0, None).astype(int)
        last = np.clip(np.ceil(boxes.max(axis=(0, 1))), 0, None).astype(int)
        fitting = int((boxes[:, 1] - boxes[:, 0]).min()) // _LEAST_SAMPLES
        stride = math.ceil(math.sqrt(float(np.prod(last - first + 1.0)) / _MONTE_CARLO_PIXELS))
        stride = max(1, min(stride, max(int(2 * errors.correlation_px), fitting)))
        part = slice(first[1], last[1] + 1, stride), slice(first[0], last[0] + 1, stride)
        thinned = matched[part]
        moved = [region.shifted(*first).scaled(1 / stride) for region in request.step]
        masks = [region.mask((thinned.shape[0], thinned.shape[1])) for region in moved]

        def height(heights: FloatArray) -> dict[str, float]:
            return {"step/height": step_between_regions(heights, spacing * stride, *masks).height}

        found |= monte_carlo(
            thinned,
            errors.uncertainty[part],
            height,
            correlation_sigma_px=errors.correlation_px / stride,
            random_share=_random_share(errors.correlation_px, stride),
            **named,
        )
    if request.edges:
        line = _profile(matched, spacing, request)
        ends = np.array(request.profile).reshape(2, 2)
        share = line.distance / line.distance[-1]

        def along(heights: FloatArray) -> dict[str, float]:
            step = step_along_profile(replace(line, height=heights[0]), request.edges)
            return {"step along the profile/height": step.height}

        found |= monte_carlo(
            line.height[None],
            sample_heights(errors.uncertainty, ends[0] + share[:, None] * (ends[1] - ends[0]))[None],
            along,
            correlation_sigma_px=errors.correlation_px * spacing / line.step,
            **named,
        )
    return found


def _random_share(sigma_px: float, stride: int) -> float:
    """Return by how much less a sum over all pixels scatters than one over every `stride`-th row and column."""
    return min(max(sigma_px, _WHITE_SIGMA_PX) / _WHITE_SIGMA_PX / stride, 1.0)


def step_of_profile(matched: FloatArray, spacing: float, request: MeasureRequest) -> Step:
    """Return the step at the request's edges along its profile, of the heights as they were matched."""
    return step_along_profile(_profile(matched, spacing, request), request.edges)


def _profile(matched: FloatArray, spacing: float, request: MeasureRequest) -> Profile:
    if request.profile is None:
        raise ValueError("the edges of a step belong to a profile, and the request has none")
    line = np.array(request.profile).reshape(2, 2)
    return extract_profile(matched, spacing, line[0], line[1])
