"""Areal Gaussian filters of ISO 16610-61 on maps with unknown heights.

The weighting function is s(x, y) = exp(-pi (x² + y²) / (a L)²) / (a L)² with a = sqrt(ln 2 / pi), so that a wave of the
length L, the nesting index, passes with half its height: H(l) = exp(-pi (a L / l)²). It is cut at |x|, |y| <= L, where
it has fallen to 7e-7. Unknown heights and the world beyond the edge have no weight, and what is left is renormalized
(normalized convolution): no height is made up. Within L / 2 of an edge or a hole the window is one-sided, so a slope
that is left there biases it; therefore level first.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import fft

from semscape.metrology.grid import Spacing, spacing_xy
from semscape.types import BoolArray, FloatArray

GAUSSIAN_ALPHA = float(np.sqrt(np.log(2) / np.pi))
"""a of ISO 16610-61: half the height passes at the nesting index."""

_REACH = 1.0
_PARALLEL_PIXELS = 1_000_000  # below that threads wait longer for each other than they work


def gaussian_s_filter(height: FloatArray, spacing: Spacing, nesting_index: float) -> FloatArray:
    """Return what is longer than the nesting index: the S-filter, which takes noise away.

    Parameters
    ----------
    height : (H, W) float array
        Heights, NaN = unknown; they stay unknown.
    spacing : float or (dx, dy)
        Grid spacing.
    nesting_index : float
        Wavelength that passes with half its height, in the unit of the spacing.

    References
    ----------
    ISO 16610-61; normalized convolution: Knutsson & Westin 1993, doi:10.1109/CVPR.1993.341081.

    Examples
    --------
    >>> x = np.arange(400) * 0.5
    >>> wave = np.tile(np.sin(2 * np.pi * x / 20), (60, 1))
    >>> round(float(gaussian_s_filter(wave, 0.5, 20.0)[30, 100:300].max()), 3)
    0.5
    """
    return gaussian_smoother(np.isfinite(height), spacing, nesting_index)(height)


def gaussian_l_filter(height: FloatArray, spacing: Spacing, nesting_index: float) -> FloatArray:
    """Return what is shorter than the nesting index: the L-filter, which takes waviness away."""
    return height - gaussian_s_filter(height, spacing, nesting_index)


def gaussian_smoother(
    known: BoolArray, spacing: Spacing, nesting_index: float, *, single: bool = False
) -> Callable[[FloatArray], FloatArray]:
    """Return the S-filter for all maps that are known at the same pixels: its weights are computed once.

    With `single` it computes in single precision: half the time, and errors of 1e-6 of the largest height.
    """
    if not nesting_index > 0:
        raise ValueError(f"the nesting index of a filter must be positive, got {nesting_index}")
    dx, dy = spacing_xy(spacing)
    kernels = [_kernel(nesting_index / step, n) for step, n in zip((dy, dx), known.shape, strict=True)]
    # The pad keeps one edge from reaching the other round the circle of the transform.
    shape = [fft.next_fast_len(n + len(k) // 2, real=True) for n, k in zip(known.shape, kernels, strict=True)]
    along_y = fft.fft(_centred(kernels[0], shape[0])).real
    along_x = fft.rfft(_centred(kernels[1], shape[1])).real
    precision = np.float32 if single else np.float64
    transfer = (along_y[:, None] * along_x).astype(precision)
    rows, cols = known.shape
    workers = -1 if known.size > _PARALLEL_PIXELS else 1

    def blur(values: FloatArray) -> FloatArray:
        spectrum = fft.rfft2(values.astype(precision, copy=False), shape, workers=workers)
        spectrum *= transfer
        blurred: FloatArray = fft.irfft2(spectrum, shape, workers=workers, overwrite_x=True)[:rows, :cols]
        return blurred

    weight = np.where(known, blur(known.astype(precision)), 1.0)

    def smooth(height: FloatArray) -> FloatArray:
        if not known.any():
            return height.copy()
        offset = float(np.mean(height[known]))  # a large mean would cost digits
        values = blur(np.where(known, height - offset, 0.0)) / weight + offset
        return np.where(known, values, np.nan)

    return smooth


def profile_s_filter(height: FloatArray, step: float, nesting_index: float) -> FloatArray:
    """Return the Gaussian mean line of a profile (N,) with spacing `step`: ISO 16610-21, normalized at the ends."""
    smooth = gaussian_s_filter(height[None, :], (step, step), nesting_index)
    line: FloatArray = smooth[0]
    return line


def _kernel(length_px: float, n: int) -> FloatArray:
    """Return the weights of a Gaussian of nesting index `length_px`, odd in number, no wider than the map twice."""
    reach = min(int(np.ceil(_REACH * length_px)), n - 1)
    x = np.arange(-reach, reach + 1)
    weights: FloatArray = np.exp(-np.pi * (x / (GAUSSIAN_ALPHA * length_px)) ** 2)
    weights /= weights.sum()
    return weights


def _centred(kernel: FloatArray, n: int) -> FloatArray:
    """Return the kernel on a circle of n, its middle at index 0."""
    reach = len(kernel) // 2
    circle = np.zeros(n)
    circle[: reach + 1] = kernel[reach:]
    if reach:
        circle[-reach:] = kernel[:reach]
    return circle
