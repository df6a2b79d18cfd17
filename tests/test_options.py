"""Options out of range are refused where they are made, with the option, the value and the range."""

from __future__ import annotations

import math
from typing import Any

import pytest

from semscape import options
from semscape.errors import BadInputError
from semscape.flags import effective_options, with_flags
from semscape.options import (
    DenseOptions,
    FeaturesOptions,
    MeshOptions,
    Options,
    RobustOptions,
    RunOptions,
    SfmOptions,
    read_toml,
)

STAGES = {
    "features": FeaturesOptions,
    "robust": RobustOptions,
    "sfm": SfmOptions,
    "dense": DenseOptions,
    "mesh": MeshOptions,
    "run": RunOptions,
}


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("features.contrast_threshold", 0.0, "> 0"),
        ("features.normalization_sigma_px", -1.0, "> 0"),
        ("features.max_keypoints", 99, ">= 100"),
        ("features.ratio", 1.01, "> 0 and <= 1"),
        ("robust.max_trials", 9, ">= 10"),
        ("robust.min_inliers", 7, ">= 8"),
        ("sfm.prior_tilt_deg", 0.0, "> 0"),
        ("sfm.prior_roll_deg", math.nan, "> 0"),
        ("sfm.prior_scale", math.inf, "> 0"),
        ("sfm.max_tilt_deg", 81.0, "> 0 and <= 80"),
        ("sfm.de_generations", 0, ">= 1"),
        ("sfm.de_population_per_variable", 1, ">= 2"),
        ("sfm.max_iterations", 0, ">= 1"),
        ("dense.max_pairs", 0, ">= 1"),
        ("dense.census_radius_px", 4, ">= 1 and <= 3"),
        ("dense.penalty_small", 25.0, "<= dense.penalty_large"),
        ("dense.penalty_large", 9000.0, "> 0 and <= 8000"),
        ("dense.left_right_limit_px", 0.0, "> 0"),
        ("dense.mesh_max_vertices", 3, ">= 4"),
        ("dense.tile_px", -1, ">= 0"),
        ("dense.tile_px", 1, "0 or >= 64"),
        ("mesh.triangles", -1, ">= 0"),
        ("mesh.error_um", -0.5, ">= 0"),
        ("run.seed", -1, ">= 0"),
    ],
)
def test_a_value_out_of_range_is_refused_however_it_is_given(name: str, value: Any, allowed: str) -> None:
    stage, key = name.split(".")
    message = f"^option {name} is {value:g}, must be {allowed}"
    with pytest.raises(BadInputError, match=message):
        STAGES[stage](**{key: value})
    with pytest.raises(BadInputError, match=message):
        Options().with_settings([f"{name}={value}"])
    with pytest.raises(BadInputError, match=message):
        read_toml(f"[{stage}]\n{key} = {value}\n")


def test_every_number_has_its_range() -> None:
    numbers = {
        f"{stage}.{key}"
        for stage, values in Options().to_dict().items()
        for key, value in values.items()
        if stage != "input" and isinstance(value, int | float) and not isinstance(value, bool)
    }
    assert numbers == set(options._RANGES)


def test_the_ends_of_the_ranges_are_allowed() -> None:
    text = "[features]\nratio = 1\nmax_keypoints = 100\n[dense]\npenalty_small = 24\ncensus_radius_px = 1\n"
    assert read_toml(text).dense.penalty_small == 24


def test_settings_are_checked_together() -> None:
    found = Options().with_settings(["dense.penalty_small=30", "dense.penalty_large=40"])
    assert (found.dense.penalty_small, found.dense.penalty_large) == (30, 40)


def test_an_unknown_detector_names_the_nearest_one() -> None:
    with pytest.raises(BadInputError, match=r"option features\.detector has no choice 'surff'.*'surf'"):
        Options().with_settings(["features.detector=surff"])


def test_the_camera_flag_beats_the_settings() -> None:
    nothing = (None, None, None, None, None)
    assert effective_options(None, ["sfm.camera=perspective"], *nothing, camera="auto").sfm.camera == "auto"
    assert effective_options(None, ["sfm.camera=perspective"], *nothing).sfm.camera == "perspective"
    with pytest.raises(BadInputError, match=r"sfm.camera has no choice 'fisheye'.*orthographic, perspective, auto"):
        with_flags(Options(), camera="fisheye")


def test_the_preset_of_the_thesis_is_its_method() -> None:
    assert with_flags(Options(), preset="thesis").sfm.method == "thesis"
    assert with_flags(Options()).sfm.method == "series"
    with pytest.raises(BadInputError, match="--preset 'fast' is not known; there is: thesis"):
        with_flags(Options(), preset="fast")
