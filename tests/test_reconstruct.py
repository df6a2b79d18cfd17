"""The whole straight line on a small simulated series: accuracy both ways, the run folder, the same bytes."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from scipy.ndimage import map_coordinates
from typer.testing import CliRunner

import semscape
from semscape.cli import app
from semscape.geometry.cameras import camera_matrices
from semscape.io.run_folder import RUN_FILES, reconstruction_to_dict
from semscape.io.simulated import write_simulated_series
from semscape.io.surfaces import read_height_map
from semscape.report import render_html
from semscape.report.run import write_run
from semscape.simulate import SimulationOptions, simulate
from semscape.types import Result, SimulationTruth
from synthetic_result import make_result, with_reconstruction

MICROSCOPE = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=288, height_px=256)
TRUE_STAGE = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=320, height_px=320, stage_error_deg=0.0)
SAME_BYTES = ("reconstruction.json", "height_map.npz", "height_map.tif", "points.ply", "mesh.ply", "mesh.glb")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images and truth as `semscape simulate` writes them."""
    path = tmp_path_factory.mktemp("reconstruct") / "images"
    return write_simulated_series(path, *simulate("fracture", MICROSCOPE, rng=3))


@pytest.fixture(scope="module")
def run_folder(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reconstruct-run") / "run"
    done = run("reconstruct", folder, "-o", path, "--workers", 1)
    assert done.exit_code == 0, done.output
    return path


@pytest.fixture(scope="module")
def solved() -> tuple[Result, SimulationTruth]:
    """A series whose stage tells the truth, so that errors are those of the images."""
    series, truth = simulate("fracture", TRUE_STAGE, rng=1)
    return semscape.reconstruct(series, semscape.Options(), rng=0), truth


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def height_errors_px(result: Result, truth: SimulationTruth) -> np.ndarray:
    """Return the errors of all known heights, in px.

    The origin of the world is a choice. So each point of the map goes through the recovered reference camera into the
    picture, and back through the true one onto the true surface; what is left of the height's origin is its median.
    """
    found, motion, reference = result.height_map, result.reconstruction.motion, result.reconstruction.reference
    rows, cols = np.nonzero(np.isfinite(found.height_um))
    height = found.height_um[rows, cols]
    world = (np.column_stack([cols, rows, height, np.ones(len(rows))]) @ found.world_from_grid.T)[:, :3]
    xy = world @ camera_matrices(motion)[reference].T + motion.translation_px[reference]
    matrix = camera_matrices(truth.motion)[reference]
    in_plane = xy - truth.motion.translation_px[reference] - np.outer(height, matrix[:, 2])
    true_xy = np.linalg.solve(matrix[:, :2], in_plane.T).T
    grid = (true_xy - truth.world_from_grid[:2, 3]) / np.diag(truth.world_from_grid)[:2]
    true = map_coordinates(truth.height_um, grid[:, ::-1].T, order=1, cval=np.nan)
    error = (height - true) / truth.pixel_size_um
    error = error[np.isfinite(error)]
    return np.asarray(error - np.median(error))


# Accuracy: two-sided, for a result that is too good is suspicious as well


def test_tilts_are_right(solved: tuple[Result, SimulationTruth]) -> None:
    result, truth = solved
    error = np.rad2deg(result.reconstruction.motion.tilt_rad - truth.motion.tilt_rad)
    assert np.abs(error).max() < 0.1
    assert np.abs(error).max() > 1e-5
    assert (np.abs(error) < 3 * np.rad2deg(result.reconstruction.tilt_sigma_rad)).all()
    assert np.rad2deg(result.reconstruction.motion.axis_angle_rad) == pytest.approx(90, abs=1.0)


def test_the_residual_is_that_of_keypoints(solved: tuple[Result, SimulationTruth]) -> None:
    assert 0.05 < solved[0].reconstruction.rms_px < 0.35


def test_heights_are_right_and_not_suspiciously_so(solved: tuple[Result, SimulationTruth]) -> None:
    error = np.abs(height_errors_px(*solved))
    relief = np.ptp(np.nanpercentile(solved[1].height_um, [1, 99])) / solved[1].pixel_size_um
    assert relief > 30
    # Three views and keypoint-like noise: 0.2 px of disparity over 2 sin(6 deg) is 1 px of height.
    assert 0.1 < np.median(error) < 1.8
    assert np.percentile(error, 90) < 5.0


def test_the_relief_is_the_right_way_up(solved: tuple[Result, SimulationTruth]) -> None:
    result, truth = solved
    known = np.isfinite(result.height_map.height_um) & np.isfinite(truth.height_um)
    assert np.corrcoef(result.height_map.height_um[known], truth.height_um[known])[0, 1] > 0.5


def test_the_map_is_nearly_complete_and_never_filled(solved: tuple[Result, SimulationTruth]) -> None:
    known = np.isfinite(solved[0].height_map.height_um)
    assert 0.85 < known.mean() < 0.9999
    np.testing.assert_array_equal(np.isfinite(solved[0].height_map.uncertainty_um), known)
    np.testing.assert_array_equal(solved[0].height_map.n_views >= 2, known)


def test_the_stated_uncertainty_is_that_of_the_errors(solved: tuple[Result, SimulationTruth]) -> None:
    error = height_errors_px(*solved)
    stated = solved[0].height_map.uncertainty_um / solved[1].pixel_size_um
    assert 0.3 < np.median(np.abs(error)) / (0.6745 * np.nanmedian(stated)) < 3


# The same bytes


def test_workers_change_no_byte(folder: Path, run_folder: Path, tmp_path: Path) -> None:
    assert run("reconstruct", folder, "-o", tmp_path / "run", "--workers", 2, "-q").exit_code == 0
    for name in SAME_BYTES:
        assert (tmp_path / "run" / name).read_bytes() == (run_folder / name).read_bytes(), name


def test_the_options_file_repeats_the_run(folder: Path, run_folder: Path, tmp_path: Path) -> None:
    done = run("reconstruct", folder, "-o", tmp_path / "run", "--options", run_folder / "options.toml")
    assert done.exit_code == 0, done.output
    for name in (*SAME_BYTES, "options.toml"):
        assert (tmp_path / "run" / name).read_bytes() == (run_folder / name).read_bytes(), name


def test_another_seed_gives_nearly_the_same_result(folder: Path, run_folder: Path) -> None:
    result = semscape.reconstruct(semscape.load_series(folder), rng=77)
    told = json.loads((run_folder / "reconstruction.json").read_text(encoding="utf-8"))
    tilts = np.rad2deg(result.reconstruction.motion.tilt_rad)
    np.testing.assert_allclose(tilts, [view["tilt_deg"] for view in told["views"]], atol=0.05)
    assert result.report.seed == 77


# The run folder


def test_every_file_of_the_contract_is_there(run_folder: Path) -> None:
    assert sorted(path.name for path in run_folder.iterdir()) == sorted([*RUN_FILES, "run.log"])
    assert set(RUN_FILES) == {
        "report.json", "report.html", "reconstruction.json", "points.ply", "mesh.ply", "mesh.glb", "height_map.npz",
        "height_map.tif", "options.toml",
    }  # fmt: skip


def test_reconstruction_json_holds_the_contract(run_folder: Path) -> None:
    told = json.loads((run_folder / "reconstruction.json").read_text(encoding="utf-8"))
    for key in ("axis_deg", "tilt_source", "height_scale_relative_sigma", "ambiguity", "rms_px", "n_tracks"):
        assert told[key] is not None, key
    assert (told["tilt_source"], told["ambiguity"]) == ("metadata", "none")
    for view in told["views"]:
        keys = {"name", "tilt_deg", "tilt_sigma_deg", "roll_deg", "scale_px_per_um", "R", "t_px"}
        assert keys <= set(view)
        rotation = np.array(view["R"])
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        # At a small tilt the camera still looks down on the specimen.
        assert np.trace(rotation @ np.diag([1, -1, -1])) > 2.95
        assert len(view["t_px"]) == 2


def test_the_height_map_maps_into_the_world_and_the_views(run_folder: Path) -> None:
    """A point of the map, put through world_from_grid and a view's R and t, falls where the sparse points fall."""
    height_map = read_height_map(run_folder / "height_map.npz")
    told = json.loads((run_folder / "reconstruction.json").read_text(encoding="utf-8"))
    with np.load(run_folder / "height_map.npz") as archive:
        assert {"height_um", "uncertainty_um", "pixel_size_um", "world_from_grid"} <= set(archive.files)
    known = np.isfinite(height_map.height_um)
    rows, cols = np.nonzero(known)
    grid = np.column_stack([cols, rows, height_map.height_um[known], np.ones(len(rows))])
    world = grid @ height_map.world_from_grid.T
    np.testing.assert_allclose(world[:, 2], height_map.height_um[known])
    reference = next(view for view in told["views"] if view["name"] == told["reference_view"])
    xy = world[:, :3] @ (reference["scale_px_per_um"] * np.array(reference["R"])[:2]).T + reference["t_px"]
    # The reference is nearly at zero tilt: the grid is nearly its pixels.
    assert np.abs(np.median(xy - np.column_stack([cols, rows]), axis=0)).max() < 3
    assert np.diag(height_map.world_from_grid).tolist() == pytest.approx(
        [height_map.pixel_size_um, -height_map.pixel_size_um, 1, 1]
    )


def test_all_products_agree_with_each_other(run_folder: Path) -> None:
    import trimesh

    height_map = read_height_map(run_folder / "height_map.npz")
    np.testing.assert_array_equal(
        tifffile.imread(run_folder / "height_map.tif"), height_map.height_um.astype(np.float32)
    )
    mesh = trimesh.load(run_folder / "mesh.ply", process=False)
    glb = trimesh.load(run_folder / "mesh.glb", process=False, force="mesh")
    assert len(mesh.faces) == len(glb.faces) > 10_000
    np.testing.assert_allclose(mesh.bounds, glb.bounds, atol=1e-4)
    low, high = np.nanmin(height_map.height_um), np.nanmax(height_map.height_um)
    assert low - 1e-4 <= mesh.bounds[0, 2] < mesh.bounds[1, 2] <= high + 1e-4
    assert np.median(mesh.face_normals[:, 2]) > 0
    points = trimesh.load(run_folder / "points.ply").vertices
    told = json.loads((run_folder / "reconstruction.json").read_text(encoding="utf-8"))
    assert len(points) == told["n_tracks"]
    # Sparse and dense were measured by different means, and meet.
    matrix = np.linalg.inv(height_map.world_from_grid)
    grid = np.rint((np.column_stack([points, np.ones(len(points))]) @ matrix.T)[:, :2]).astype(int)
    inside = ((grid >= 0) & (grid < height_map.height_um.shape[::-1])).all(axis=1)
    difference = points[inside, 2] - height_map.height_um[grid[inside, 1], grid[inside, 0]]
    assert np.nanmedian(np.abs(difference)) < 2 * height_map.pixel_size_um
    assert abs(np.nanmedian(difference)) < 0.5 * height_map.pixel_size_um


def test_the_report_tells_how_the_result_came_about(folder: Path, run_folder: Path) -> None:
    report = json.loads((run_folder / "report.json").read_text(encoding="utf-8"))
    assert {"views", "pairs", "stages", "warnings", "options", "seed", "versions", "inputs", "metrics"} <= set(report)
    assert [stage["name"] for stage in report["stages"]] == ["detect", "match", "calibrate", "surface", "mesh"]
    assert len(report["pairs"]) == 3
    for pair in report["pairs"]:
        assert pair["pair"][0] < pair["pair"][1]
        assert pair["matches"] >= pair["inliers"] >= 24
        assert pair["tracks"] > 24
        assert 0 < pair["threshold_px"] < 10
        assert pair["log10_nfa"] < 0
    import hashlib

    for entry in report["inputs"]:
        assert entry["digest"] == hashlib.sha256((folder / entry["name"]).read_bytes()).hexdigest()
    assert 0 < report["metrics"]["completeness"] <= 1
    assert report["options"]["run"]["seed"] == report["seed"] == 0
    assert tomllib.loads((run_folder / "options.toml").read_text(encoding="utf-8"))["sfm"] == report["options"]["sfm"]
    html = (run_folder / "report.html").read_text(encoding="utf-8")
    assert html.startswith("<!DOCTYPE html>")
    assert "http://" not in html.replace("http://www.w3.org", "")


def test_a_run_may_be_repeated_into_its_own_folder(folder: Path, run_folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    assert run("reconstruct", folder, "-o", output, "-q").exit_code == 0
    before = (output / "reconstruction.json").read_bytes()
    assert run("reconstruct", folder, "-o", output, "-q").exit_code == 0
    assert (output / "reconstruction.json").read_bytes() == before
    assert sorted(path.name for path in output.iterdir()) == sorted([*RUN_FILES, "run.log"])


def test_the_tilt_that_a_self_calibration_holds_has_no_sigma() -> None:
    result = make_result()
    motion = replace(result.reconstruction.motion, tilt_rad=np.deg2rad([-3.0, 1e-7, 3.0]))
    free = with_reconstruction(result, motion=motion, tilt_source="self-calibrated")
    told = reconstruction_to_dict(free.reconstruction, free.series.names)["views"]
    assert [view["tilt_sigma_deg"] > 0 for view in told] == [True, False, True]
    assert '<td class="num">0 (held)</td>' in render_html(free)
    assert "(held)" not in render_html(result)


# Units


def test_without_a_pixel_size_everything_says_px(folder: Path, tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for path in folder.glob("*.tif"):
        tifffile.imwrite(images / path.name, tifffile.imread(path))  # the same pixels without a header
    done = run("reconstruct", images, "-o", tmp_path / "run", "--tilts", "-6,0,6")
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "run" / "reconstruction.json").read_text(encoding="utf-8"))
    report = json.loads((tmp_path / "run" / "report.json").read_text(encoding="utf-8"))
    assert told["length_unit"] == report["length_unit"] == "px"
    assert told["tilt_source"] == "user"

    def keys(value: object) -> list[str]:
        if isinstance(value, dict):
            return [*value, *(key for item in value.values() for key in keys(item))]
        return [key for item in value for key in keys(item)] if isinstance(value, list) else []

    assert not [key for key in keys(told) if key.endswith("_um")]
    produced = {key: report[key] for key in ("metrics", "views", "pairs", "stages")}
    assert not [key for key in keys(produced) if key.endswith("_um")]
    with np.load(tmp_path / "run" / "height_map.npz") as archive:
        assert {"height_px", "uncertainty_px", "pixel_size_px"} <= set(archive.files)
        assert not [key for key in archive.files if key.endswith("_um")]
        assert archive["pixel_size_px"] == pytest.approx(1, rel=0.01)
    for name in ("points.ply", "mesh.ply"):
        assert b"pixel (px)" in (tmp_path / "run" / name).read_bytes()[:400]
    assert "µm" not in done.stdout
    assert " um" not in done.stdout


# Python


def test_the_python_of_the_readme_works_verbatim(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent)
    folder.rename("pollen")
    try:
        series = semscape.load_series("pollen/")
        result = semscape.reconstruct(series, semscape.Options(), rng=0)
    finally:
        Path("pollen").rename(folder)
    assert isinstance(result, Result)
    assert result.height_map.height_um.shape == series.shape
    assert result.report.verdict


def test_progress_tells_each_stage_twice() -> None:
    series, _ = simulate("fracture", MICROSCOPE, rng=3)
    told: list[tuple[str, bool]] = []
    semscape.reconstruct(series, rng=0, progress=lambda name, figures: told.append((name, figures is not None)))
    names = ["detect", "match", "calibrate", "surface", "mesh"]
    assert told == [(name, ended) for name in names for ended in (False, True)]


def test_a_view_of_another_specimen_is_left_out_and_named(tmp_path: Path) -> None:
    microscope = SimulationOptions(tilts_deg=(-6.0, -2.0, 2.0, 6.0), width_px=256, height_px=256)
    series, _ = simulate("fracture", microscope, rng=3)
    stranger, _ = simulate("pollen", microscope, rng=4)
    mixed = type(series)((*series.views[:3], stranger.views[3]))
    result = semscape.reconstruct(mixed, rng=0)
    assert result.series.n_views == 3
    assert len(result.reconstruction.motion.tilt_rad) == 3
    assert any(mixed.names[3] in warning and "left out" in warning for warning in result.report.warnings)
    assert len(result.report.failures) == 3
    write_run(result, tmp_path / "run")
    told = json.loads((tmp_path / "run" / "reconstruction.json").read_text(encoding="utf-8"))
    assert [view["name"] for view in told["views"]] == list(mixed.names[:3])
