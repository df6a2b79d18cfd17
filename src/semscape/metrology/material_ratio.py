"""Parameters from the areal material ratio curve: Sk Spk Svk Smr1 Smr2, Sxp, Vmp Vmc Vvv Vvc (ISO 25178-2, -3).

The curve is taken exactly: the known heights in falling order, the i-th of N at the material ratio (i + 1/2) / N, and
between them straight lines. Volumes and the areas of Spk and Svk are sums over all heights, not over a table of the
curve: a table of 10,000 points overstates the volume of a few deep pits by percents.
"""

from __future__ import annotations

import numpy as np

from semscape.metrology.grid import known_heights
from semscape.types import FloatArray

_CORE_SHARE = 0.4


def material_ratio_parameters(height: FloatArray) -> dict[str, float]:
    """Return the parameters of the material ratio curve.

    - The core line is the least-squares line through that 40 % of the curve whose secant is flattest (the first, if
      several are). Sk is its fall from 0 to 100 %; Smr1 and Smr2 are where the curve leaves the core.
    - Spk and Svk are the heights of right triangles over 0 to Smr1 and Smr2 to 100 % with the areas of the hills
      above and the dales below the core.
    - Sxp = c(2.5 %) - c(50 %), c(p) the curve's height.
    - Vm(p) = mean max(z - c(p), 0) and Vv(p) = mean max(c(p) - z, 0); Vmp = Vm(10 %), Vmc = Vm(80 %) - Vm(10 %),
      Vvv = Vv(80 %), Vvc = Vv(10 %) - Vv(80 %).

    Parameters
    ----------
    height : (H, W) float array
        Levelled (and filtered) heights, NaN = unknown.

    Returns
    -------
    dict
        Smr1 and Smr2 in percent; volumes per area, so that all others have the heights' unit (um³/um² = um).

    Raises
    ------
    NoAnswerError
        If fewer than ten heights are known.

    References
    ----------
    ISO 25178-2:2021, 4.4; ISO 13565-2 for the core line.

    Examples
    --------
    On heights that are all alike often the curve is one straight line, and all of it is core:

    >>> found = material_ratio_parameters(np.linspace(0, 1, 10001).reshape(73, -1))
    >>> [round(found[name], 3) for name in ("Sk", "Spk", "Svk", "Sxp", "Vmp", "Vmc")]
    [1.0, 0.0, 0.0, 0.475, 0.005, 0.315]
    """
    falling = np.sort(known_heights(height, least=10))[::-1]
    n = len(falling)
    ratio = (np.arange(n) + 0.5) / n
    return _core(falling, ratio) | _extreme_and_volumes(falling, ratio)


def _core(falling: FloatArray, ratio: FloatArray) -> dict[str, float]:
    n = len(falling)
    span = round(_CORE_SHARE * n)
    start = int(np.argmin(falling[: n - span] - falling[span:]))
    x, z = ratio[start : start + span + 1], falling[start : start + span + 1]
    x_mean, z_mean = x.mean(), z.mean()
    slope = float(((x - x_mean) * (z - z_mean)).sum() / ((x - x_mean) ** 2).sum())
    top = float(z_mean - slope * x_mean)
    bottom = top + slope
    # falling is sorted: what is above and below a level are its two ends.
    n_hills = int(np.searchsorted(-falling, -top, side="left"))
    n_dales = n - int(np.searchsorted(-falling, -bottom, side="right"))
    smr1, smr2 = n_hills / n, 1 - n_dales / n
    hills = float((falling[:n_hills] - top).sum()) / n
    dales = float((bottom - falling[n - n_dales :]).sum()) / n
    return {
        "Sk": -slope,
        "Spk": 2 * hills / smr1 if n_hills else 0.0,
        "Svk": 2 * dales / (1 - smr2) if n_dales else 0.0,
        "Smr1": 100 * smr1,
        "Smr2": 100 * smr2,
    }


def _extreme_and_volumes(falling: FloatArray, ratio: FloatArray) -> dict[str, float]:
    def curve(share: float) -> float:
        return float(np.interp(share, ratio, falling))

    def material(share: float) -> float:
        return float(np.maximum(falling - curve(share), 0).mean())

    def void(share: float) -> float:
        return float(np.maximum(curve(share) - falling, 0).mean())

    return {
        "Sxp": curve(0.025) - curve(0.5),
        "Vmp": material(0.1),
        "Vmc": material(0.8) - material(0.1),
        "Vvv": void(0.8),
        "Vvc": void(0.1) - void(0.8),
    }
