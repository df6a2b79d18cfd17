"""Spatial parameters of ISO 25178-2 from the autocorrelation: Sal and Str.

The autocorrelation at a lag is the mean product of the heights (mean removed) that lie that far apart, over the pairs
where both are known, divided by the mean square: no zeros are put in for what is beyond the edge or unknown, which
would pull it down. It is computed for lags up to half the field, beyond which too few pairs are left.
"""

from __future__ import annotations

import numpy as np
from scipy import fft, ndimage

from semscape.metrology.grid import Spacing, known_heights, spacing_xy
from semscape.types import FloatArray

_DIRECTIONS = 360
_STEPS_PER_PX = 4
_LEAST_PAIRS = 0.05


def autocorrelation(height: FloatArray) -> FloatArray:
    """Return the autocorrelation for lags -H/2 .. H/2 and -W/2 .. W/2 px, lag zero in the middle, where it is 1.

    NaN where fewer than 5 % of the pixels have a known partner. The spectra are in single precision: errors of 1e-6.

    Raises
    ------
    NoAnswerError
        If no height is known.
    """
    known = np.isfinite(height)
    mean = known_heights(height).mean()
    z = np.where(known, height - mean, 0.0)
    power = float((z * z).sum()) / known.sum()
    rows, cols = height.shape
    reach = rows // 2, cols // 2
    shape = [fft.next_fast_len(n + lag, real=True) for n, lag in zip(height.shape, reach, strict=True)]

    def correlated(values: FloatArray) -> FloatArray:
        spectrum = fft.rfft2(values.astype(np.float32), shape, workers=-1)
        full = fft.irfft2(spectrum.real**2 + spectrum.imag**2, shape, workers=-1)
        lags_y, lags_x = (np.arange(-lag, lag + 1) for lag in reach)
        lags: FloatArray = full[np.ix_(lags_y, lags_x)].astype(np.float64)
        return lags

    if known.all():
        pairs = np.outer(*(n - np.abs(np.arange(-lag, lag + 1.0)) for n, lag in zip(height.shape, reach, strict=True)))
    else:
        pairs = correlated(known.astype(np.float64))
    enough = pairs >= _LEAST_PAIRS * height.size
    scale = np.sqrt(power) if power > 0 else 1.0  # a value near one keeps single precision
    return np.where(enough, correlated(z / scale) / np.maximum(pairs, 1.0), np.nan)


def spatial_parameters(height: FloatArray, spacing: Spacing, threshold: float = 0.2) -> dict[str, float]:
    """Return Sal, the lag at which the autocorrelation falls to the threshold fastest, and Str = Sal over the slowest.

    Along 360 directions over a half turn the autocorrelation is read off by bilinear interpolation at quarter pixels,
    and its first fall to the threshold is interpolated. Str is NaN where it does not fall that far in some direction
    within half the shorter side: then the field is too small for the texture (a lay, a form that was left in).

    Parameters
    ----------
    height : (H, W) float array
        Levelled (and filtered) heights, NaN = unknown.
    spacing : float or (dx, dy)
        Grid spacing.
    threshold : float
        s of ISO 25178-2, default 0.2.

    Returns
    -------
    dict
        Sal in the unit of the spacing (NaN where no direction falls to the threshold), Str without unit.

    References
    ----------
    ISO 25178-2:2021, 4.3.
    """
    dx, dy = spacing_xy(spacing)
    correlation = autocorrelation(height)
    middle_y, middle_x = correlation.shape[0] // 2, correlation.shape[1] // 2
    angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    step = min(dx, dy) / _STEPS_PER_PX
    longest = min(middle_x * dx, middle_y * dy)
    radii = np.arange(0.0, longest + step / 2, step)
    fallen = np.full(_DIRECTIONS, np.nan)
    for i, angle in enumerate(angles):
        along = ndimage.map_coordinates(
            correlation,
            [middle_y + radii * np.sin(angle) / dy, middle_x + radii * np.cos(angle) / dx],
            order=1,
            mode="nearest",
        )
        below = np.flatnonzero(along < threshold)
        if len(below) and below[0] > 0 and np.isfinite(along[: below[0]]).all():  # at lag 0 it is 1, or all is flat
            j = below[0]
            fallen[i] = radii[j - 1] + step * (along[j - 1] - threshold) / (along[j - 1] - along[j])
    if np.isnan(fallen).all():
        return {"Sal": np.nan, "Str": np.nan}
    shortest = float(np.nanmin(fallen))
    return {"Sal": shortest, "Str": shortest / float(fallen.max())}
