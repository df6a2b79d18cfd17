from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from semscape import doctor
from semscape.cli import app


@pytest.fixture
def images(tmp_path: Path) -> Path:
    done = CliRunner().invoke(
        app, ["simulate", "-o", str(tmp_path / "images"), "--tilts", "-6,0,6", "--size", "128", "-q"]
    )
    assert done.exit_code == 0
    return tmp_path / "images"


def reconstruct_in_process(images: Path, output: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "semscape", "reconstruct", images, "-o", output, *arguments]
    command += ["--set", "sfm.de_generations=10", "--set", "dense.max_pairs=1"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


def test_log_json_is_lines_of_json_alone(images: Path, tmp_path: Path) -> None:
    done = reconstruct_in_process(images, tmp_path / "run", "--log-json")
    assert done.returncode == 0, done.stderr
    # Python's reader takes NaN, others do not.
    lines = [json.loads(line, parse_constant=pytest.fail) for line in done.stderr.splitlines()]
    ended = [line["stage"] for line in lines if line["message"].endswith(" ended")]
    assert ended == ["detect", "match", "calibrate", "surface", "mesh", "report"]
    assert {"time", "level", "logger", "message"} <= set(lines[0])
    kept = [json.loads(line) for line in (tmp_path / "run" / "run.log").read_text(encoding="utf-8").splitlines()]
    took = {line["stage"]: line for line in kept if "seconds" in line}
    assert list(took) == ["detect", "match", "calibrate", "surface", "mesh"]
    assert all(line["peak_memory_mb"] > 50 for line in took.values())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere", "-o", "out"], "there is no such folder"),
        (["nowhere", "-o", "out", "--debug"], "there is no such folder"),
        (["nowhere"], "Missing option '--output'"),
        (["nowhere", "-o", "out", "--tilt", "3"], "No such option: --tilt"),
    ],
)
def test_log_json_tells_errors_as_json_too(tmp_path: Path, arguments: list[str], message: str) -> None:
    command = [sys.executable, "-m", "semscape", "reconstruct", *arguments, "--log-json"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, cwd=tmp_path)
    assert done.returncode == 2
    last = [json.loads(line) for line in done.stderr.splitlines()][-1]
    assert message in last["message"]
    assert (last["level"], last["exit_code"]) == ("ERROR", 2)
    assert ("traceback" in last) == ("--debug" in arguments)


def test_the_log_of_a_run_is_not_shown(images: Path, tmp_path: Path) -> None:
    done = reconstruct_in_process(images, tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert "semscape.run" not in done.stderr
    assert "\nmatch: " in done.stderr


def test_warnings_about_the_files_come_once_and_before_the_work(images: Path, tmp_path: Path) -> None:
    done = reconstruct_in_process(images, tmp_path / "run")
    lines = done.stderr.splitlines()
    assert lines[0].startswith("warning: ")
    assert "the sign of this Zeiss stage's tilt is assumed" in lines[0]
    assert lines[1].startswith("detect: ")
    assert len(lines) == len(set(lines))


def test_the_doctor_finds_this_installation_well() -> None:
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 0, done.output
    for word in ("python:", "numpy:", "cores:", "memory:", "BLAS:", "extra cluster:", "result:        good"):
        assert word in done.output


def test_the_doctor_says_so_when_results_are_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "self_test", lambda: 0.3)
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 1
    assert "WRONG, median height error 30.0 %" in done.output
