"""Profiles along any line of a height map, and their parameters (ISO 21920-2).

A profile is sampled bilinearly every smaller one of the grid's steps. The P-profile has its least-squares line taken
off; the R-profile is the P-profile less its Gaussian mean line (ISO 16610-21) of the nesting index Nic, lambda c in
older standards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from semscape.errors import NoAnswerError
from semscape.metrology.filters import profile_s_filter
from semscape.metrology.grid import Spacing, spacing_xy
from semscape.types import FloatArray

_SECTIONS = 5
_LEAST_SAMPLES = 8
_LONGEST_IN_MAPS = 10


@dataclass(frozen=True, eq=False)
class Profile:
    """Heights (N,) along a line, NaN = unknown, at `distance` (N,) from its start, evenly spaced by `step`."""

    distance: FloatArray
    height: FloatArray
    step: float


def extract_profile(height: FloatArray, spacing: Spacing, start_px: FloatArray, end_px: FloatArray) -> Profile:
    """Return the heights along a straight line.

    Parameters
    ----------
    height : (H, W) float array
        Heights, NaN = unknown.
    spacing : float or (dx, dy)
        Grid spacing.
    start_px, end_px : (2,) float arrays
        Ends of the line, (x, y) px.

    Raises
    ------
    NoAnswerError
        If fewer than eight heights along it are known, or it is far longer than the map.

    Examples
    --------
    >>> ramp = np.tile(np.arange(40.0), (40, 1))
    >>> line = extract_profile(ramp, 0.5, np.array([5.0, 5.0]), np.array([35.0, 5.0]))
    >>> line.step, float(line.distance[-1]), float(line.height[-1])
    (0.5, 15.0, 35.0)
    """
    dx, dy = spacing_xy(spacing)
    start, end = np.asarray(start_px, dtype=np.float64), np.asarray(end_px, dtype=np.float64)
    length = float(np.hypot((end[0] - start[0]) * dx, (end[1] - start[1]) * dy))
    # The step divides the length, so that the last sample is the end of the line.
    count = max(round(length / min(dx, dy)), 1)
    rows, cols = height.shape
    if count > _LONGEST_IN_MAPS * (rows + cols) * max(dx, dy) / min(dx, dy):
        raise NoAnswerError(
            f"the profile is {length:.3g} long, and the map only {cols * dx:.3g} x {rows * dy:.3g}; draw it over the "
            "known part of the map"
        )
    share = np.linspace(0.0, 1.0, count + 1)
    sampled = sample_heights(height, start + share[:, None] * (end - start))
    known = int(np.isfinite(sampled).sum())
    if known < _LEAST_SAMPLES:
        raise NoAnswerError(
            f"{known} of {len(sampled)} heights along the profile are known, need {_LEAST_SAMPLES}; "
            "draw it over the known part of the map"
        )
    return Profile(share * length, sampled, length / count)


def sample_heights(height: FloatArray, xy_px: FloatArray) -> FloatArray:
    """Return the heights (N,) at points (N, 2) px, bilinear; NaN outside and where one that is needed is unknown."""
    sampled: FloatArray = ndimage.map_coordinates(height, xy_px.T[::-1], order=1, mode="constant", cval=np.nan)
    return sampled


def profile_parameters(profile: Profile, nesting_index: float | None = None) -> dict[str, float]:
    """Return Pa Pq Pt, and with a nesting index Ra Rq Rz Rt and the number of section lengths behind Rz.

    Parameters
    ----------
    profile : Profile
        As it was extracted: its slope is taken off here.
    nesting_index : float, optional
        Nic in the unit of the distance, which is also the section length. Without it there is no R-profile.

    Returns
    -------
    dict
        `Pa` = mean |z|, `Pq` = root mean square, `Pt` = highest less lowest, over all that is known. `Ra`, `Rq`, `Rt`
        the same of the R-profile, without half a Nic at each end, where its mean line is one-sided. `Rz` = mean over
        the sections of highest less lowest, where a section counts if half of it is known. ISO 21920-3 wants five
        sections; `sections` says how many there are, up to five, from the middle of the profile. Without a single one
        (the profile is shorter than two Nic) all of R is NaN.

    References
    ----------
    ISO 21920-2:2021; ISO 21920-3:2021.

    Examples
    --------
    >>> x = np.arange(0, 100, 0.1)
    >>> wave = Profile(x, np.sin(2 * np.pi * x / 2), 0.1)
    >>> found = profile_parameters(wave, 10.0)
    >>> round(found["Ra"] * np.pi / 2, 2), round(found["Rz"], 1), found["sections"]
    (0.99, 2.0, 5.0)
    """
    primary = _without_line(profile)
    known = np.isfinite(primary)
    z = primary[known]
    found = {"Pa": float(np.abs(z).mean()), "Pq": float(np.sqrt((z * z).mean())), "Pt": float(np.ptp(z))}
    if nesting_index is None:
        return found
    travel = round(nesting_index / 2 / profile.step)
    rough = (primary - profile_s_filter(primary, profile.step, nesting_index))[travel : len(primary) - travel]
    heights = _section_heights(rough, profile.step, nesting_index)
    if not heights:
        return found | dict.fromkeys(("Ra", "Rq", "Rz", "Rt"), np.nan) | {"sections": 0.0}
    z = rough[np.isfinite(rough)]
    found |= {"Ra": float(np.abs(z).mean()), "Rq": float(np.sqrt((z * z).mean()))}
    return found | {"Rz": float(np.mean(heights)), "Rt": float(np.ptp(z)), "sections": float(len(heights))}


def _without_line(profile: Profile) -> FloatArray:
    known = np.isfinite(profile.height)
    x, z = profile.distance[known], profile.height[known]
    if len(z) < 2:
        raise NoAnswerError(f"{len(z)} heights of the profile are known, need 2")
    slope, offset = np.polynomial.polynomial.polyfit(x - x.mean(), z, 1)[::-1]
    straight: FloatArray = profile.height - offset - slope * (profile.distance - x.mean())
    return straight


def _section_heights(rough: FloatArray, step: float, section: float) -> list[float]:
    per_section = max(round(section / step), 2)
    count = min(len(rough) // per_section, _SECTIONS)
    first = (len(rough) - count * per_section) // 2
    parts = [rough[first + i * per_section : first + (i + 1) * per_section] for i in range(count)]
    return [float(np.nanmax(part) - np.nanmin(part)) for part in parts if np.isfinite(part).mean() >= 0.5]
