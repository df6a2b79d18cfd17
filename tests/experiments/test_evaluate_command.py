"""`semscape evaluate` on a run folder, and what it says when run and truth do not belong together."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from semscape.cli import app
from semscape.io.surfaces import read_height_map
from semscape.report.figures import error_picture


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("evaluate")
    call("simulate", "face", "-o", folder / "sim", "--views", 3, "--step", 6, "--size", 160, "--seed", 2, "-q")
    call("reconstruct", folder / "sim", "-o", folder / "run", "-q")
    return folder / "run", folder / "sim"


def call(*words: object, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done.stdout if code == 0 else done.stderr


def test_figures_as_json_and_a_picture(folders: tuple[Path, Path], tmp_path: Path) -> None:
    run, sim = folders
    told = json.loads(call("evaluate", run, "--truth", sim, "-o", tmp_path / "new"))
    assert set(told["surface"]) == {"none", "rigid", "similarity"}
    assert 0.2 < told["heights"]["median_abs_error_px"] < 4
    assert told["heights"]["median_abs_error_um"] == pytest.approx(
        0.1 * told["heights"]["median_abs_error_px"], rel=1e-3
    )
    assert len(told["views"]["tilt_error_deg"]) == 3
    assert told["surface"]["rigid"]["rmse_px"] < told["surface"]["none"]["rmse_px"]
    assert (tmp_path / "new" / "height_error.png").read_bytes().startswith(b"\x89PNG")
    assert not (run / "height_error.png").exists()


def test_a_view_left_out_is_no_error(folders: tuple[Path, Path], tmp_path: Path) -> None:
    """The truth follows the names of the run's views, whatever their order and number."""
    run, sim = folders
    told = json.loads((run / "reconstruction.json").read_text())
    for name in ("height_map.npz", "mesh.ply"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    told["views"] = told["views"][1:]
    (tmp_path / "reconstruction.json").write_text(json.dumps(told))
    whole = json.loads(call("evaluate", run, "--truth", sim, "-o", tmp_path))
    less = json.loads(call("evaluate", tmp_path, "--truth", sim))
    assert less["views"]["tilt_error_deg"] == whole["views"]["tilt_error_deg"][1:]
    assert less["heights"]["rmse_um"] == whole["heights"]["rmse_um"]


def test_against_a_mesh(folders: tuple[Path, Path]) -> None:
    run, sim = folders
    told = json.loads(call("evaluate", run, "--truth", sim / "truth_mesh.ply"))
    assert set(told) == {"run", "truth", "length_unit", "pixel_size_um", "relief_um", "surface"}
    assert told["surface"]["rigid"]["median_px"] < 3


def test_a_truth_of_another_series_or_none_is_told(folders: tuple[Path, Path], tmp_path: Path) -> None:
    run, _ = folders
    assert "holds no readable truth" in call("evaluate", run, "--truth", tmp_path, code=2)
    call("simulate", "face", "-o", tmp_path / "other", "--tilts=-4,0,5", "--size", 64, "-q")
    assert "is not one of the series" in call("evaluate", run, "--truth", tmp_path / "other", code=2)
    # The same tilts, so the same names; only the images tell that it is another specimen.
    call("simulate", "pollen", "-o", tmp_path / "like", "--views", 3, "--step", 6, "--size", 160, "--seed", 2, "-q")
    assert "was made from another view_00_-06.00deg.tif" in call(
        "evaluate", run, "--truth", tmp_path / "like", "-o", tmp_path, code=2
    )
    assert not (tmp_path / "height_error.png").exists()
    assert "is not a mesh file" in call("evaluate", run, "--truth", tmp_path / "truth.xyz", code=2)
    assert "height_map.npz" in call("evaluate", tmp_path, "--truth", tmp_path / "other", code=2)


def test_the_picture_of_errors_is_white_where_there_is_none(folders: tuple[Path, Path]) -> None:
    height_map = read_height_map(folders[0] / "height_map.npz")
    error = np.zeros(height_map.height_um.shape)
    error[0, 0], error[-1, -1] = 1.0, -1.0
    assert error_picture(height_map, error) != error_picture(height_map, -error)
    assert error_picture(height_map, np.full(error.shape, np.nan)).startswith(b"\x89PNG")


def test_experiments_name_the_nearest_one(tmp_path: Path) -> None:
    assert "the nearest one is 'faces'" in call("experiments", "fasces", "-o", tmp_path, code=2)
