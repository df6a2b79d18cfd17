"""Step heights of ISO 5436-1: between two regions of a map, and of a groove or a single step along a profile.

Both fit two parallel lines (planes) by least squares at once: z = slope x + offset + d [in the upper part]. A tilt that
was left, or put in by levelling over the step, then cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.errors import NoAnswerError
from semscape.metrology.grid import Spacing, spacing_xy
from semscape.metrology.profile import Profile
from semscape.types import BoolArray, FloatArray

_GUARD_SHARE = 1 / 3


@dataclass(frozen=True)
class Step:
    """A step: `height` along z, second part less first (a groove's bottom less its rims), as ISO 5436-1 has it.

    `perpendicular` is the distance of the two parallel planes or lines along their normal; `residual_rms` what they
    leave over.
    """

    height: float
    perpendicular: float
    residual_rms: float


def step_between_regions(height: FloatArray, spacing: Spacing, first: BoolArray, second: BoolArray) -> Step:
    """Return the height of the second region above the first, by two parallel planes.

    Parameters
    ----------
    height : (H, W) float array
        Heights, NaN = unknown.
    spacing : float or (dx, dy)
        Grid spacing.
    first, second : (H, W) bool arrays
        The regions; keep them clear of the edge between them.

    Raises
    ------
    NoAnswerError
        If a region holds fewer than three known heights.

    References
    ----------
    ISO 5436-1:2000, type A1, over areas instead of lines.

    Examples
    --------
    >>> rows, cols = np.indices((20, 40))
    >>> map_um = 0.05 * cols + np.where(cols >= 20, 2.0, 0.0)
    >>> round(step_between_regions(map_um, 1.0, cols < 15, cols >= 25).height, 9)
    2.0
    """
    dx, dy = spacing_xy(spacing)
    parts = [np.nonzero(region & np.isfinite(height)) for region in (first, second)]
    counts = [len(rows) for rows, _ in parts]
    if min(counts) < 3:
        raise NoAnswerError(f"the two regions of the step hold {counts[0]} and {counts[1]} known heights, need 3 each")
    rows, cols = (np.concatenate(axis) for axis in zip(*parts, strict=True))
    upper = np.repeat([0.0, 1.0], counts)
    return _parallel_fit([cols * dx, rows * dy], height[rows, cols], upper)


def step_along_profile(profile: Profile, edges: tuple[float, ...]) -> Step:
    """Return the depth of a groove (two edges) or the height of a single step (one edge) along a profile.

    With two edges, W apart, ISO 5436-1 type A1: the rims count from W/3 to W beside each edge, and of the bottom the
    middle third. With one edge nothing nearer to it than a third of the way to the nearer end counts, and both
    sides count up to that length; the standard has no single step.

    Parameters
    ----------
    profile : Profile
    edges : one or two floats
        Distance of the edges from the profile's start.

    Raises
    ------
    NoAnswerError
        If the profile does not reach far enough on each side, or too little of it is known.
    """
    x, length = profile.distance, float(profile.distance[-1])
    if len(edges) == 1:
        reach = min(edges[0], length - edges[0])
        guard = _GUARD_SHARE * reach
        rims = (x >= edges[0] - reach) & (x <= edges[0] - guard)
        inner = (x >= edges[0] + guard) & (x <= edges[0] + reach)
    elif len(edges) == 2:
        left, right = sorted(edges)
        width = right - left
        guard = _GUARD_SHARE * width
        rims = ((x >= left - width) & (x <= left - guard)) | ((x >= right + guard) & (x <= right + width))
        inner = (x >= left + guard) & (x <= right - guard)
        if left - width < -profile.step or right + width > length + profile.step:
            raise NoAnswerError(
                f"the groove from {left:.6g} to {right:.6g} needs its width, {width:.6g}, on each side; the profile "
                f"goes from 0 to {length:.6g}: draw it longer"
            )
    else:
        raise ValueError(f"a step has one edge, a groove two, got {len(edges)}")
    known = np.isfinite(profile.height)
    rims, inner = rims & known, inner & known
    if min(rims.sum(), inner.sum()) < 2:
        raise NoAnswerError(
            f"{rims.sum()} heights before the step and {inner.sum()} on it are known, need 2 each; move the edges"
        )
    both = rims | inner
    return _parallel_fit([x[both]], profile.height[both], inner[both].astype(np.float64))


def _parallel_fit(axes: list[FloatArray], z: FloatArray, upper: FloatArray) -> Step:
    design = np.column_stack([upper, np.ones_like(z), *(axis - axis.mean() for axis in axes)])
    z = z - z.mean()
    size = np.sqrt((design**2).mean(axis=0))
    size[size == 0] = 1.0
    scaled = design / size
    normal, right = np.einsum("ni,nj->ij", scaled, scaled), np.einsum("ni,n->i", scaled, z)
    solution = np.linalg.lstsq(normal, right, rcond=1e-12)[0] / size
    residual = z - np.einsum("ni,i->n", design, solution)
    steepness = np.sqrt(1 + float((solution[2:] ** 2).sum()))
    rise = float(solution[0])
    return Step(rise, rise / steepness, float(np.sqrt((residual**2).mean())))
