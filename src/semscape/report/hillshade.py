"""Shaded relief of a height map."""

from __future__ import annotations

import numpy as np

from semscape.types import FloatArray


def hillshade(
    height: FloatArray, pixel_size: float, *, azimuth_deg: float = 315.0, altitude_deg: float = 45.0
) -> FloatArray:
    """Return the brightness of a surface under a distant lamp.

    Parameters
    ----------
    height : (H, W) float array
        Heights over a grid whose first row lies at the largest y, NaN where unknown.
    pixel_size : float
        Grid spacing in the heights' unit.
    azimuth_deg : float
        Where the light comes from, clockwise from up in the picture; 315 is the upper left.
    altitude_deg : float
        Height of the lamp over the horizon.

    Returns
    -------
    (H, W) float array
        Cosine of the angle between surface normal and light, 0 in shadow; NaN where the height is NaN.

    Raises
    ------
    ValueError
        If the pixel size is not a positive number.

    References
    ----------
    B. K. P. Horn, "Hill shading and the reflectance map", Proc. IEEE 69 (1981), doi:10.1109/PROC.1981.11918.

    Examples
    --------
    A flat surface has the sine of the lamp's altitude everywhere:

    >>> round(float(hillshade(np.zeros((3, 3)), 1.0)[1, 1]), 4)
    0.7071
    """
    if not pixel_size > 0:
        raise ValueError(f"pixel_size must be a positive number, got {pixel_size}")
    slope_x = _slope(height, axis=1) / pixel_size
    slope_y = -_slope(height, axis=0) / pixel_size
    azimuth, altitude = np.deg2rad(azimuth_deg), np.deg2rad(altitude_deg)
    light = np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])
    cosine = (-slope_x * light[0] - slope_y * light[1] + light[2]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    shade: FloatArray = np.where(np.isfinite(height), np.maximum(cosine, 0.0), np.nan)
    return shade


def _slope(height: FloatArray, axis: int) -> FloatArray:
    """Return the difference per grid step: central, one-sided beside a hole, 0 for a lone pixel."""
    step = np.diff(np.asarray(height, dtype=np.float64), axis=axis)
    pad = [(0, 0), (0, 0)]
    pad[axis] = (1, 1)
    padded = np.pad(step, pad, constant_values=np.nan)
    before = np.take(padded, range(padded.shape[axis] - 1), axis=axis)
    after = np.take(padded, range(1, padded.shape[axis]), axis=axis)
    known = np.isfinite(before).astype(np.float64) + np.isfinite(after)
    slope: FloatArray = (np.nan_to_num(before) + np.nan_to_num(after)) / np.maximum(known, 1.0)
    return slope
