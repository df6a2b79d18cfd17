"""A calibration's end as a start: how far a refinement with tighter tolerances still moves the tilts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from semscape.options import SfmOptions
from semscape.sfm.adjust import Adjustment, adjust
from semscape.sfm.anisotropy import adjust_learning_anisotropy
from semscape.sfm.calibrate import calibrate
from semscape.sfm.priors import MotionPrior
from semscape.types import Observations, TiltSeries


def moved_by_restart_deg(series: TiltSeries, observations: Observations) -> float:
    """Calibrate, refine again from the answer a thousand times stricter, and return the largest change of a tilt."""
    ends: list[tuple[Observations, MotionPrior, Adjustment, float]] = []

    def remembered(first: Adjustment, kept: Observations, prior: MotionPrior, **named: Any) -> Any:
        learnt, found = adjust_learning_anisotropy(first, kept, prior, **named)
        ends.append((kept, learnt, found, named["overdispersion"]))
        return learnt, found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("semscape.sfm.calibrate.adjust_learning_anisotropy", remembered)
        calibrate(series, observations, SfmOptions(), rng=np.random.default_rng(0))
        patch.setattr("semscape.sfm.adjust._RELATIVE_TOLERANCE", 1e-17)
        patch.setattr("semscape.sfm.adjust._REWEIGHTING_TOLERANCE", 1e-10)
        kept, learnt, found, overdispersion = ends[0]
        again = adjust(found.parameters, kept, learnt, max_iterations=1000, overdispersion=overdispersion)
    assert again.n_iterations > 1
    return float(np.rad2deg(np.abs(again.parameters - found.parameters)[1::6]).max())
