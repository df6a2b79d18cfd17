"""Milliseconds of robust estimation on 10,000 matches, beside PoseLib and OpenCV's USAC_MAGSAC, as JSON.

All run on one core on the same matches, in turns, and the median of the turns' processor times counts: it does not
grow where other programs share the machine. "Equal trials": our estimates
and PoseLib draw exactly 2,000 samples (ours a tenth more among the inliers). USAC_MAGSAC takes 2,000 as its limit and
the confidence nearest to one; it may still stop earlier and does not tell how many it drew. The second row of each
lets all stop by their own rule. The rivals estimate the full fundamental matrix and are given 1 px as threshold.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from statistics import median
from typing import Any

# Before anything loads a library with threads of its own.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

from isolated import Case, run_cases  # noqa: E402

_N_MATCHES = 10_000
_TRIALS = 2000
_THRESHOLD_PX = 1.0
_TURNS = 7


def measure(outlier_share: float) -> dict[str, Any]:
    """Time all estimators on one pair and return its row of the table."""
    import cv2
    import numpy as np
    import poselib

    from semscape.experiments.synthetic_matches import SHAPES, synthetic_pair
    from semscape.robust.acransac import ac_ransac
    from semscape.robust.models import AFFINE, FUNDAMENTAL, HOMOGRAPHY, Model

    cv2.setNumThreads(1)
    pair = synthetic_pair(_N_MATCHES, outlier_share, 0.5, rng=np.random.default_rng(0))
    x1, x2 = pair.x1, pair.x2

    def ours(model: Model, **stop: float) -> np.ndarray:
        return ac_ransac(model, x1, x2, shapes=SHAPES, rng=np.random.default_rng(0), max_trials=_TRIALS, **stop).inliers

    def poselib_fundamental(**settings: int) -> np.ndarray:
        options = {"max_epipolar_error": _THRESHOLD_PX, "max_iterations": _TRIALS, **settings}
        return np.array(poselib.estimate_fundamental(x1, x2, options, {})[1]["inliers"], dtype=bool)

    def magsac(confidence: float) -> np.ndarray:
        found = cv2.findFundamentalMat(x1, x2, cv2.USAC_MAGSAC, _THRESHOLD_PX, confidence, _TRIALS)
        return found[1].ravel().astype(bool)

    estimators: dict[str, Callable[[], np.ndarray]] = {
        "affine": lambda: ours(AFFINE, failure_probability=0),
        "fundamental": lambda: ours(FUNDAMENTAL, failure_probability=0),
        "homography": lambda: ours(HOMOGRAPHY, failure_probability=0),
        "PoseLib fundamental": lambda: poselib_fundamental(min_iterations=_TRIALS),
        "USAC_MAGSAC fundamental": lambda: magsac(1 - 1e-15),
        "affine, own stop": lambda: ours(AFFINE),
        "PoseLib fundamental, own stop": lambda: poselib_fundamental(),
        "USAC_MAGSAC fundamental, own stop": lambda: magsac(0.999),
    }
    seconds: dict[str, list[float]] = {name: [] for name in estimators}
    figures = {}
    for turn in range(_TURNS + 1):
        for name, estimator in estimators.items():
            start = time.process_time()
            inliers = estimator()
            if turn:  # the first compiles
                seconds[name].append(time.process_time() - start)
            figures[name] = {
                "precision": round(float(pair.right[inliers].mean()), 4),
                "recall": round(float(inliers[pair.right].mean()), 4),
            }
    milliseconds = {name: 1e3 * median(times) for name, times in seconds.items()}
    faster = min(milliseconds["PoseLib fundamental"], milliseconds["USAC_MAGSAC fundamental"])
    return {
        "matches": _N_MATCHES,
        "outlier_share": outlier_share,
        "trials": _TRIALS,
        "milliseconds": {name: round(value, 2) for name, value in milliseconds.items()},
        "affine_over_faster_rival": round(milliseconds["affine"] / faster, 3),
        "figures": figures,
    }


CASES: dict[str, Case] = {f"outliers-{share:.0%}": (measure, (share,)) for share in (0.2, 0.5, 0.8)}

if __name__ == "__main__":
    run_cases(CASES, "Milliseconds of robust estimation beside PoseLib and OpenCV, as JSON.")
