"""How the uncertainty of the heights becomes the uncertainty of a parameter: Monte Carlo (JCGM 101).

Noise is drawn, many times: white noise smoothed by a Gaussian of the width sigma_c (px), brought back to unit variance
and multiplied by each height's own uncertainty. Two heights d px apart then share exp(-d² / (4 sigma_c²)) of their
errors. Matching over a window of that sigma leaves just such errors.

The height scale, one factor 1 + s for the whole map, s its relative sigma, needs no draws: figures change with it in
proportion, and by how much is seen on the map times 1 + s.

Each draw is measured like the map. The mean of the draws lies above the map's own value by what noise adds: as the map
already holds such noise once, its value exceeds the surface's by about as much (`noise_bias`). That is told and not
taken off, so it counts in sigma: scatter of the draws, bias and change by the scale, added in squares. Errors that are
smooth over the whole field, apart from the scale, are not drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from semscape.types import FloatArray

_FINEST_COARSE_PX, _NODES_PER_SIGMA = 16.0, 8.0

Measure = Callable[[FloatArray], Mapping[str, float]]


@dataclass(frozen=True)
class Estimate:
    """A value with its 1-sigma uncertainty, and by how much noise has made it larger; NaN where that is unknown."""

    value: float
    sigma: float = np.nan
    noise_bias: float = np.nan


def monte_carlo(
    height: FloatArray,
    uncertainty: FloatArray,
    measure: Measure,
    *,
    correlation_sigma_px: float,
    scale_relative_sigma: float,
    draws: int,
    random_share: float = 1.0,
    rng: np.random.Generator,
) -> dict[str, Estimate]:
    """Measure a map, and its noisy copies, and return each figure with its uncertainty.

    Parameters
    ----------
    height : (H, W) float array
        Heights, NaN = unknown.
    uncertainty : (H, W) float array
        1 sigma of each height in the same unit; unknown ones (NaN) take the median of the known ones.
    measure : callable
        Figures by name of a height map (H, W); it should do all that was done with the map, levelling included.
    correlation_sigma_px : float
        sigma_c; 0 draws white noise.
    scale_relative_sigma : float
        s; NaN (unknown) makes the sigmas unknown, too.
    draws : int
        Number of draws, at least two; sigmas scatter by 1 / sqrt(2 draws).
    random_share : float
        By which the scatter of the draws is multiplied: below 1 where the map stands for one of more pixels.
    rng : numpy.random.Generator
        Where the draws come from.

    References
    ----------
    JCGM 101:2008 (GUM supplement 1).

    Examples
    --------
    >>> flat, sigma = np.zeros((50, 50)), np.full((50, 50), 0.3)
    >>> found = monte_carlo(flat, sigma, lambda z: {"mean": float(z.mean())}, correlation_sigma_px=0.0,
    ...                     scale_relative_sigma=0.0, draws=200, rng=np.random.default_rng(0))
    >>> 0.005 < found["mean"].sigma < 0.007  # 0.3 / sqrt(2500)
    True
    """
    if draws < 2:
        raise ValueError(f"a Monte Carlo needs at least 2 draws, got {draws}")
    known = np.isfinite(height)
    sigma = filled_uncertainty(uncertainty, known)
    base = measure(height)
    if not (np.isfinite(scale_relative_sigma) and np.isfinite(sigma[known]).all()):
        return {name: Estimate(value) for name, value in base.items()}
    samples: dict[str, list[float]] = {name: [] for name in base}
    for _ in range(draws):
        for name, value in measure(
            height + sigma * correlated_noise(height.shape, correlation_sigma_px, rng=rng)
        ).items():
            samples[name].append(value)
    scaled = measure(height * (1 + scale_relative_sigma)) if scale_relative_sigma else base
    found = {}
    for name, value in base.items():
        bias = float(np.mean(samples[name])) - value
        scatter = float(np.std(samples[name], ddof=1)) * random_share
        found[name] = Estimate(value, math.hypot(scatter, bias, scaled[name] - value), bias)
    return found


def correlated_noise(shape: tuple[int, int], sigma_px: float, *, rng: np.random.Generator) -> FloatArray:
    """Return noise (H, W) of unit variance and autocorrelation exp(-d² / (4 sigma²)); white for sigma 0.

    Where sigma is beyond 16 px the noise is drawn on a coarser grid, of 8 to a sigma, and interpolated: it takes no
    more memory however wide it is.
    """
    if sigma_px < 0.1:
        return rng.standard_normal(shape, dtype=np.float32).astype(np.float64)
    if sigma_px > _FINEST_COARSE_PX:
        step = sigma_px / _NODES_PER_SIGMA
        rows, cols = (np.arange(size) / step for size in shape)
        nodes = correlated_noise((int(rows[-1]) + 2, int(cols[-1]) + 2), _NODES_PER_SIGMA, rng=rng)
        return np.asarray(ndimage.map_coordinates(nodes, np.meshgrid(rows, cols, indexing="ij"), order=1))
    reach = int(np.ceil(4 * sigma_px))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    kernel = (kernel / np.sqrt((kernel**2).sum())).astype(np.float32)
    # Drawn with a margin, so that the field's edge is like its middle.
    noise = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach), dtype=np.float32)
    for axis in (0, 1):
        noise = ndimage.correlate1d(noise, kernel, axis=axis)
    smooth: FloatArray = noise[reach:-reach, reach:-reach].astype(np.float64)
    return smooth


def filled_uncertainty(uncertainty: FloatArray, known: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> FloatArray:
    """Return the uncertainty with the median of the known ones where a height has none; NaN if none has any."""
    usable = known & np.isfinite(uncertainty)
    typical = float(np.median(uncertainty[usable])) if usable.any() else np.nan
    return np.where(usable, uncertainty, typical)
