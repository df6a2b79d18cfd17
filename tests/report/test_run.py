from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from semscape.errors import BadInputError
from semscape.io.run_folder import RUN_FILES
from semscape.options import Options
from semscape.report import report_to_dict, write_run
from semscape.report.summary import build_report
from synthetic_result import make_result, with_reconstruction, with_report

RESULT = make_result()


def test_write_run_writes_the_whole_contract_and_may_be_repeated(tmp_path) -> None:
    folder = write_run(RESULT, tmp_path / "run")
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert set(first) == set(RUN_FILES)
    write_run(RESULT, folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == first


def test_write_run_refuses_a_foreign_folder(tmp_path) -> None:
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(BadInputError, match=r"notes\.txt"):
        write_run(RESULT, tmp_path)


def test_the_report_is_strict_json_with_every_table() -> None:
    report = json.loads(json.dumps(report_to_dict(RESULT), allow_nan=False))
    assert report["views"][2]["tilt_deg"] == pytest.approx(2.99)
    assert report["views"][2]["scale_sigma_px_per_um"] == pytest.approx(0.9993 / 0.05 * 3e-4)
    assert report["height_scale"] == "height scale ±1.1 % (95 %)"
    assert report["pairs"][0]["threshold_px"] == 0.83
    assert [stage["name"] for stage in report["stages"]] == ["detect", "match", "robust", "sfm", "dense"]
    for key in ("metrics", "warnings", "failures", "options", "seed", "versions", "inputs", "verdict", "length_unit"):
        assert key in report


def test_numpy_values_in_a_report_are_plain_in_json() -> None:
    report = report_to_dict(with_report(RESULT, metrics={"a": np.float64(1.5), "b": np.arange(2), "c": np.nan}))
    assert report["metrics"] == {"a": 1.5, "b": [0, 1], "c": None}


def verdict_with(**changes: Any) -> str:
    report = build_report(
        RESULT.series,
        with_reconstruction(RESULT, **changes).reconstruction,
        RESULT.height_map,
        stages=(),
        pairs=(),
        keypoints=RESULT.keypoints,
        options=Options(),
        failures=(),
    )
    return report.verdict


def test_a_height_scale_of_unknown_error_is_not_measured() -> None:
    verdict = verdict_with(height_scale_relative_sigma=np.nan)
    assert verdict.startswith("do not measure: nothing tells how well the tilts are known")


def test_a_relief_that_the_shading_calls_inverted_is_not_good() -> None:
    assert verdict_with(relief_confidence=1.0).startswith("good: ")
    verdict = verdict_with(relief_confidence=0.01)
    assert verdict.startswith("usable: ")
    assert "the shading contradicts the sign of the tilts" in verdict
