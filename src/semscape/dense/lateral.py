"""The lateral resolution of the most probable surface: which waves of the true heights it holds.

Where stiffness k and prior variance tau² are even, the heights (k + D' D / tau²)^-1 k h0 hold a wave of the frequency w
(rad per px) with the share x / (x + w⁴), x = k tau²: half of it at w = x^(1/4). The same x says over how many pixels
the posterior averages, 8 / sqrt(x), which is the area 4 pi sigma² of the Gaussian window that `averaging_width` tells.
So the period that passes half is 2 pi x^(-1/4) = 2 pi sigma sqrt(pi / 2).

The noise that comes through with the heights is alike over about as far: its spectrum x² / (x + w⁴)² spans the area
16 / sqrt(x), that of noise under a Gaussian window of 0.18 periods.

Where brightness tells slopes as well, `dense.posterior` weighs both: finer waves pass.
"""

from __future__ import annotations

import numpy as np

from semscape.types import FloatArray, ImageArray

_PERIOD_PER_WIDTH = 2 * np.pi * np.sqrt(np.pi / 2)
_FINEST_PX = 2.0
# The estimate is no better than that, and files shrink.
_DECIMALS = 1


def half_passing_period(averaging_width_px: FloatArray) -> ImageArray:
    """Return the period in px of the wave that passes with half its height, where the posterior averages so widely.

    Parameters
    ----------
    averaging_width_px : (H, W) float array
        Sigma of the Gaussian window that averages as many pixels as the posterior does.

    References
    ----------
    ISO 25178-600:2019, 3.1.30 (lateral period limit); Wahba 1990, doi:10.1137/1.9781611970128 (splines as filters).

    Examples
    --------
    >>> half_passing_period(np.array([[0.1, 2.0, 4.0]])).tolist()[0]
    [2.0, 15.699999809265137, 31.5]
    """
    return stated_period(_PERIOD_PER_WIDTH * averaging_width_px)


def stated_period(period_px: FloatArray) -> ImageArray:
    """Return periods (H, W) in px as they are stated: no finer than an image holds, and rounded."""
    return np.asarray(np.round(np.maximum(period_px, _FINEST_PX), _DECIMALS), np.float32)
