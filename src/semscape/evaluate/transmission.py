"""Which waves of the true surface a height map holds: the lateral resolution that was really reached.

Heights and truth are filtered to a narrow band around each period. The slope of the one over the other is the share of
a true wave that the map holds; their squared correlation is the coherence, which noise lowers as well. Places near what
is unknown, near jumps and near the frame are left out, for the band's waves reach there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from semscape.evaluate.units import rounded
from semscape.types import BoolArray, FloatArray, HeightMap

# Width of a band, and how far its waves reach.
_OCTAVES = 0.35
_REACH_PERIODS = 0.7
_STEEPEST = 1.5
_USUAL_SIGMAS = 3.0
_LEAST_PLACES = 500
_PERIODS_PX = np.geomspace(8.0, 48.0, 19)


@dataclass(frozen=True, eq=False)
class Transmission:
    """Per period (K,) px: the share of a true wave's height that the map holds, and their coherence.

    `half_px` is the period at which the share falls to one half, `coherent_px` that at which the coherence does. NaN
    where too few places show it.
    """

    period_px: FloatArray
    share: FloatArray
    coherence: FloatArray
    half_px: float
    coherent_px: float


def wave_transmission(
    found_px: FloatArray, true_px: FloatArray, period_px: FloatArray = _PERIODS_PX, *, where: BoolArray | None = None
) -> Transmission:
    """Compare a height map with the truth, wave by wave.

    Parameters
    ----------
    found_px, true_px : (H, W) float arrays
        Heights over one grid, in px of it, laid over each other; NaN = unknown.
    period_px : (K,) float array
        Rising.
    where : (H, W) bool array, optional
        Places to compare.

    Examples
    --------
    >>> true = 0.1 * np.random.default_rng(0).normal(size=(300, 300))
    >>> found = ndimage.gaussian_filter(true, 3.0)  # half of a wave of 5.34 * 3 px passes
    >>> 15 < wave_transmission(found, true).half_px < 18
    True
    """
    known = np.isfinite(found_px) & np.isfinite(true_px)
    left_out = ~known | (np.hypot(*np.gradient(np.where(known, true_px, 0.0))) > _STEEPEST)
    if left_out.all():
        nothing = np.full(len(period_px), np.nan)
        return Transmission(period_px, nothing, nothing, np.nan, np.nan)
    distance = ndimage.distance_transform_edt(~np.pad(left_out, 1, constant_values=True))[1:-1, 1:-1]
    compared = np.ones_like(known) if where is None else where
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    # Cosine transforms mirror the map at its frame: no edge, no leak.
    found, true = (fft.dctn(z[tuple(nearest)], norm="ortho") for z in (found_px, true_px))
    radius = np.hypot(*np.ogrid[tuple(slice(0.0, 0.5, complex(0, n + 1)) for n in known.shape)])[:-1, :-1]
    octaves = np.log2(np.maximum(radius, 1e-9))
    share, coherence = np.full(len(period_px), np.nan), np.full(len(period_px), np.nan)
    for i, period in enumerate(period_px):
        places = compared & (distance > _REACH_PERIODS * period)
        if places.sum() < max(_LEAST_PLACES, period**2):
            continue
        band = np.exp(-0.5 * ((octaves + np.log2(period)) / _OCTAVES) ** 2)
        ours, theirs = (fft.idctn(z * band, norm="ortho")[places] for z in (found, true))
        # The waves of a tall jump reach farther, and both maps hold all of it.
        usual = np.abs(theirs) <= _USUAL_SIGMAS * 1.4826 * np.median(np.abs(theirs))
        ours, theirs = ours[usual], theirs[usual]
        cross, power = float(np.sum(ours * theirs)), float(np.sum(theirs**2))
        share[i], coherence[i] = cross / power, cross**2 / (power * float(np.sum(ours**2)))
    return Transmission(period_px, share, coherence, _crossing(period_px, share), _crossing(period_px, coherence))


def transmission_figures(height_map: HeightMap, true_um: FloatArray) -> dict[str, float]:
    """Return the lateral period limit that a height map states (median) and the true ones, in px of its grid.

    `true_period_px` is where half of a true wave's height is left, `coherent_period_px` where their coherence is half.
    """
    pixel = height_map.pixel_size_um
    found = wave_transmission(height_map.height_um / pixel, true_um / pixel)
    stated = height_map.lateral_period_um[np.isfinite(height_map.lateral_period_um)]
    return {
        "stated_period_px": rounded(float(np.median(stated)) / pixel, 3) if len(stated) else np.nan,
        "true_period_px": rounded(found.half_px, 3),
        "coherent_period_px": rounded(found.coherent_px, 3),
    }


def _crossing(period: FloatArray, values: FloatArray) -> float:
    """Return the shortest period above which all values known exceed one half, interpolated; NaN for none."""
    known = np.isfinite(values)
    period, values = period[known], values[known]
    below = np.flatnonzero(values < 0.5)
    if not len(values) or not len(below) or below[-1] == len(values) - 1:
        return np.nan
    i = below[-1]
    return float(np.exp(np.interp(0.5, values[i : i + 2], np.log(period[i : i + 2]))))
