"""The surfaces that figures are taken of: form, S-filter, form once more, L-filter (ISO 25178-3)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import numpy as np

from semscape.metrology.filters import gaussian_smoother
from semscape.metrology.level import FormName, level, majority
from semscape.options import MeasureOptions
from semscape.types import FloatArray


def prepared_surfaces(
    height: FloatArray, spacing: float, options: MeasureOptions, *, for_draws: bool = False
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Return a function from heights, known where `height` is, to the S-F and the S-L surface.

    The filters' weights are computed once. For the draws of a Monte Carlo so is the majority that a robust fit
    levels on, for it is the same in all of them, and the filters compute in single precision.
    """
    form = cast("FormName", options.level)
    known = np.isfinite(height)
    robust, region = options.robust and form != "none", None
    if robust and for_draws:
        robust, region = False, majority(level(height, spacing, form, robust=True).height)
    if form == "sphere":
        known = np.isfinite(level(height, spacing, form, robust=options.robust).height)
    s_filter, l_filter = (
        None if math.isnan(index) else gaussian_smoother(known, spacing, index, single=for_draws)
        for index in (options.s_filter_um, options.l_filter_um)
    )

    def prepare(heights: FloatArray) -> tuple[FloatArray, FloatArray]:
        smooth = np.where(known, level(heights, spacing, form, robust=robust, region=region).height, np.nan)
        if s_filter is not None:
            # A draw's sphere may end a little earlier; what it does not reach must not become a hole of the filter.
            smooth = s_filter(np.where(known, np.nan_to_num(smooth), np.nan))
            if form not in ("none", "sphere"):
                smooth = level(smooth, spacing, form, robust=robust, region=region).height
        if l_filter is None:
            return smooth, smooth
        return smooth, smooth - l_filter(np.where(known, np.nan_to_num(smooth), np.nan))

    return prepare
