"""The lateral resolution that the matching really reached: as the run states it, else from the map's own spectrum.

The dense stage smooths each place as far as its noise and its relief ask for, and says there which wave passes with
half its height: the lateral period limit (ISO 25178-600). The median over what is measured stands for the map.

A map that says nothing is seen through one Gaussian window of the width sigma, which a wave passes with
exp(-2 pi² sigma² / l²) of its height, half of it at

    D_LIM = pi sigma sqrt(2 / ln 2) = 5.34 sigma.

Such a window smooths relief and noise alike: what the map's spectrum P(f) shows is some smooth spectrum times
exp(-4 pi² sigma² f²), which falls far faster than any surface or noise does. So

    ln P(f) = a - p ln f - 4 pi² sigma² f²,   p >= 0

is fitted over the wavelengths at which the fall stands out. Nothing finer than two pixels is ever resolved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from semscape.metrology.grid import Spacing, spacing_xy
from semscape.types import BoolArray, FloatArray, ImageArray

PERIOD_PER_SIGMA = float(np.pi * np.sqrt(2 / np.log(2)))
"""Wavelength that a Gaussian window of sigma 1 passes with half its height."""

_RINGS = 128
_LEAST_KNOWN = 2000
_JUMP_SIGMAS, _MAD = 6.0, 1.4826
_JUMP_MARGIN_PX = 3
_TAPER_PX = 12.0
# The part of the fall that is fitted, as sigma f: from where it begins to where the far tail of real windows, which
# are cut off, leaves the Gaussian.
_NEAR, _FAR = 0.08, 0.42
_LARGEST_SIGMA_PX, _SMALLEST_SIGMA_PX, _CANDIDATES = 15.0, 0.5, 48
_LEAST_RINGS = 5
_SIGNIFICANT = 4.0


@dataclass(frozen=True)
class LateralResolution:
    """Lateral period limit in px and in the map's unit, and the sigma in px of the Gaussian window that has it.

    `source` says what decided: "matching" (the run states it), "spectrum" or "pixel". `range_px` are the limits that
    the finest and the coarsest tenth of the places have; NaN where the run states none.
    """

    period_px: float
    period: float
    sigma_px: float
    source: str
    range_px: tuple[float, float] = (np.nan, np.nan)


def lateral_resolution(
    height: FloatArray, spacing: Spacing, stated: FloatArray | ImageArray | None = None
) -> LateralResolution:
    """Return the lateral period limit of a height map.

    Parameters
    ----------
    height : (H, W) float array
        Heights as they were matched, before any filter; NaN = unknown.
    spacing : float or (dx, dy)
        Grid spacing; the wider step counts where they differ.
    stated : (N,) or (h, w) float array, optional
        The limits that the matching states, in the unit of the spacing, for the places that are measured; NaN =
        unknown. Without any the map's spectrum is asked.

    Notes
    -----
    In the spectrum depth jumps are left out. A surface that ends as fast as a Gaussian by itself (a very smooth one
    without noise) looks there like one seen through a wide window, so that answer errs to the coarse side.

    References
    ----------
    ISO 25178-600:2019, 3.1.30; Guinier's fit of a Gaussian fall is the same idea for scattering.

    Examples
    --------
    >>> found = lateral_resolution(np.zeros((9, 9)), 0.1, np.full((9, 9), 1.6))
    >>> round(found.period_px, 3), found.period, round(found.sigma_px, 2), found.source
    (16.0, 1.6, 3.0, 'matching')
    """
    spacing_px = max(spacing_xy(spacing))
    known = np.array([]) if stated is None else stated[np.isfinite(stated) & (stated > 0)].astype(np.float64)
    if len(known):
        finest, middle, coarsest = np.percentile(known, [10, 50, 90])
        period_px = float(middle) / spacing_px
        span = float(finest) / spacing_px, float(coarsest) / spacing_px
        return LateralResolution(period_px, float(middle), period_px / PERIOD_PER_SIGMA, "matching", span)
    sigma = window_in_spectrum(height)
    period_px = max(PERIOD_PER_SIGMA * sigma, 2.0)
    return LateralResolution(period_px, period_px * spacing_px, sigma, "spectrum" if period_px > 2.0 else "pixel")


def window_in_spectrum(height: FloatArray) -> float:
    """Return the sigma in px of the Gaussian window that the fall of the map's spectrum shows, 0 for none."""
    bent, quiet = second_differences(height)
    if quiet.sum() < _LEAST_KNOWN:
        return 0.0
    frequency, power, count = _radial_spectrum(np.where(quiet, bent, 0.0) * tapered(quiet))
    usable = power > 0
    frequency, level, weight = frequency[usable], np.log(power[usable]), np.sqrt(count[usable])
    # Each candidate window has its band. From wide to narrow: beside its band a window shows as none or a narrower
    # one, until the candidate is the window itself.
    for candidate in np.geomspace(_LARGEST_SIGMA_PX, _SMALLEST_SIGMA_PX, _CANDIDATES):
        band = (frequency > _NEAR / candidate) & (frequency < min(_FAR / candidate, 0.5))
        if band.sum() >= _LEAST_RINGS:
            squared, error = _fitted_square(frequency[band], level[band], weight[band])
            if squared >= candidate**2 and squared > _SIGNIFICANT * error:
                return float(np.sqrt(squared))
    return 0.0


def _fitted_square(frequency: FloatArray, level: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Return the squared sigma of the window that fits a band of the spectrum, and its standard error."""
    design = np.column_stack([-((2 * np.pi * frequency) ** 2), np.ones_like(frequency), -np.log(frequency)])
    for columns in (design, design[:, :2]):
        weighted = columns * weight[:, None]
        solution = np.linalg.lstsq(weighted, level * weight, rcond=None)[0]
        if columns.shape[1] == 3 and solution[2] < 0:
            continue  # no spectrum rises towards its end without the window: then it was white
        break
    return float(solution[0]), float(np.sqrt(np.linalg.pinv(weighted.T @ weighted)[0, 0]))


def second_differences(height: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the five-point Laplacian, and where it is known and no jump.

    The Laplacian whitens the steep spectrum of relief, whose large waves would otherwise leak all over it through the
    holes of the map.
    """
    bent = np.full(height.shape, np.nan)
    middle = height[1:-1, 1:-1]
    bent[1:-1, 1:-1] = height[1:-1, 2:] + height[1:-1, :-2] + height[2:, 1:-1] + height[:-2, 1:-1] - 4 * middle
    known = np.isfinite(bent)
    if not known.any():
        return bent, known
    size = np.abs(bent)
    jump = known & (size > _JUMP_SIGMAS * _MAD * np.median(size[known]))
    near_jump = ndimage.binary_dilation(jump, np.ones((3, 3), bool), iterations=_JUMP_MARGIN_PX)
    quiet: BoolArray = known & ~near_jump
    # Where hardly anything is quiet the jumps are the surface.
    return bent, quiet if quiet.sum() > 0.1 * known.sum() else known


def tapered(quiet: BoolArray) -> FloatArray:
    """Return weights that rise smoothly from 0 at what is left out and at the frame: a sharp edge would leak."""
    framed = np.pad(quiet, 1)
    depth = ndimage.distance_transform_cdt(framed, "chessboard")[1:-1, 1:-1]  # a tenth of the time of the exact one
    weights: FloatArray = np.sin(0.5 * np.pi * np.minimum(depth / _TAPER_PX, 1.0)) ** 2
    return weights


def _radial_spectrum(bent: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return frequency (1/px), power of the heights and number of waves, per ring of the spectrum.

    The power is the median over the ring: the lines of a grating and the rays of an edge do not count.
    """
    spectrum = fft.rfft2(bent.astype(np.float32), workers=-1)
    fy, fx = fft.fftfreq(bent.shape[0])[:, None], fft.rfftfreq(bent.shape[1])[None]
    response = 4 - 2 * np.cos(2 * np.pi * fx) - 2 * np.cos(2 * np.pi * fy)
    radius = np.hypot(fx, fy)
    inside = (radius > 4 / min(bent.shape)) & (radius < 0.5)
    power = (spectrum.real[inside] ** 2 + spectrum.imag[inside] ** 2).astype(np.float64) / response[inside] ** 2
    radius = radius[inside]
    ring = (radius * 2 * _RINGS).astype(np.int16)
    order = np.argsort(ring, kind="stable")
    bounds = np.searchsorted(ring[order], np.arange(_RINGS + 1))
    filled = np.flatnonzero(np.diff(bounds))
    groups = [order[bounds[i] : bounds[i + 1]] for i in filled]
    frequency = np.array([radius[group].mean() for group in groups])
    return frequency, np.array([np.median(power[group]) for group in groups]), np.diff(bounds)[filled].astype(float)
