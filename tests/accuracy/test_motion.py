"""The motion of simulated tracks, with gates on both sides: a result that is too good fails as well.

Scale drift 0.1 %, roll 0.2 deg, 0.3 px keypoint noise, 10 % of the observations wrong, 2000 tracks. Coverage over 200
series of every case comes from `make motion`, every single tilt from `semscape experiments calibration`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import pytest

from semscape.cluster import local_mapper
from semscape.experiments.calibration import ANISOTROPY, CASES, figures_of, recover

SERIES = 30


@cache
def figures(
    case: str, series: int = SERIES, tracks: int = 2000, tilts_deg: tuple[float, ...] | None = None
) -> dict[str, Any]:
    recipe = replace(CASES[case], n_points=tracks, tilts_deg=tilts_deg or CASES[case].tilts_deg)
    with local_mapper() as mapper:
        return figures_of(list(mapper(partial(recover, recipe), range(series))))


@pytest.mark.parametrize(
    ("case", "least_deg", "most_deg"),
    [
        ("7 views, images alone", 0.005, 0.03),
        ("5 views, images alone", 0.008, 0.05),
        ("3 views, images alone", 0.02, 0.15),
    ],
)
def test_tilt_steps_from_the_images_alone(case: str, least_deg: float, most_deg: float) -> None:
    assert least_deg < figures(case)["tilt_step_rms_error_deg"] < most_deg


@pytest.mark.parametrize("case", ["5 views, stage", "5 views, stage, anisotropy"])
def test_never_worse_than_the_stage(case: str) -> None:
    """Five readings of 0.1 deg over 12 deg leave 1.05 % for the height scale, one standard deviation.

    60 series: over 30 the ratio of two such deviations is uncertain by a hundredth (1.020, over 60 and 120 1.011).
    """
    found = figures(case, 60)
    assert 0.03 < found["tilt_rms_error_deg"] < found["stage_tilt_rms_error_deg"]
    assert 0.2 < found["height_scale_median_error_percent"] < 1.0
    assert found["height_scale_rms_error_percent"] < 1.02 * found["stage_scale_rms_error_percent"]


def test_seven_readings_over_12_deg_know_the_height_scale_to_1_percent() -> None:
    """Under a scan that stretches by 0.1 %: seven readings of 0.1 deg leave 0.94 %, five 1.05 %."""
    found = figures("7 views, stage, anisotropy", tilts_deg=(-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0))
    assert 0.3 < found["height_scale_rms_error_percent"] < 1.0
    assert found["height_scale_rms_error_percent"] < 1.02 * found["stage_scale_rms_error_percent"]


@pytest.mark.parametrize(
    ("case", "tracks"), [("3 views, stage, anisotropy", 400), ("3 views, images alone, anisotropy", 2000)]
)
def test_intervals_hold_the_truth(case: str, tracks: int) -> None:
    """100 series with the anisotropy that the priors state; 200 of every case stand in docs/motion.md."""
    found = figures(case, 100, tracks)
    for what in ("tilts", "steps", "height_scale"):
        assert 90 <= found[f"{what}_in_95_percent"] <= 99, (what, found)
    assert ANISOTROPY == 0.001
