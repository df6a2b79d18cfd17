"""The folder of a simulated series: what is written is what is read, through the package's own reader."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh

from semscape.errors import BadInputError
from semscape.io.series import load_series
from semscape.io.simulated import read_truth, write_simulated_series
from semscape.simulate import PRESETS, MeshSpecimen, simulate
from semscape.types import SimulationTruth, TiltSeries

OPTIONS = replace(PRESETS["nominal"], tilts_deg=(-6.0, -2.95, 6.0), width_px=160, height_px=128)


@pytest.fixture(scope="module")
def simulation() -> tuple[TiltSeries, SimulationTruth]:
    return simulate("fracture", OPTIONS, rng=5)


def test_truth_comes_back(tmp_path: Path, simulation: tuple[TiltSeries, SimulationTruth]) -> None:
    series, truth = simulation
    folder = write_simulated_series(tmp_path / "out", series, truth)
    back = read_truth(folder)
    for key, value in asdict(truth.motion).items():
        np.testing.assert_allclose(getattr(back.motion, key), value, rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(back.stage_tilt_rad, truth.stage_tilt_rad, rtol=1e-14)
    assert back.skew == pytest.approx(truth.skew, rel=1e-14)
    assert back.working_distance_um == np.inf
    for key in ("height_um", "normals", "visible", "world_from_grid"):
        np.testing.assert_array_equal(getattr(back, key), getattr(truth, key))
    assert (back.seed, back.pixel_size_um, dict(back.settings)) == (5, 0.1, dict(truth.settings))
    assert not list(tmp_path.glob(".*"))

    told = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert [view["stage_tilt_deg"] for view in told["views"]] == pytest.approx([-6, -2.95, 6])
    mesh = trimesh.load(folder / "truth_mesh.ply", process=False)
    assert len(mesh.vertices) == 160 * 128
    assert mesh.face_normals[:, 2].min() > 0
    np.testing.assert_allclose(
        mesh.vertices[161], truth.world_from_grid[:3] @ [1, 1, truth.height_um[1, 1], 1], rtol=1e-6
    )


@pytest.mark.parametrize("data_bar_rows", [0, 24])
def test_reader_of_micrographs_understands_the_folder(tmp_path: Path, data_bar_rows: int) -> None:
    series, truth = simulate("fracture", replace(OPTIONS, data_bar_rows=data_bar_rows), rng=5)
    loaded = load_series(write_simulated_series(tmp_path / "out", series, truth))
    assert loaded.names == series.names
    np.testing.assert_allclose(loaded.tilt_rad, series.tilt_rad, atol=1e-9)
    np.testing.assert_allclose(loaded.pixel_size_um, series.pixel_size_um, rtol=1e-9)
    for there, here in zip(loaded.views, series.views, strict=True):
        np.testing.assert_array_equal(there.image, here.image)
        np.testing.assert_array_equal(there.mask, here.mask)
        assert there.metadata.vendor == here.metadata.vendor
        assert there.metadata.working_distance_um == pytest.approx(here.metadata.working_distance_um)
        assert there.metadata.accelerating_voltage_kv == here.metadata.accelerating_voltage_kv
        assert there.metadata.magnification == pytest.approx(here.metadata.magnification, abs=0.5)
        assert there.metadata.source["tilt_rad"] == "file"


def test_header_tells_the_scan_rotation_as_the_microscope_does(tmp_path: Path) -> None:
    for rotation, switch in ((0.0, "Off"), (90.0, "On"), (12.25, "On")):
        options = replace(OPTIONS, scan_rotation_deg=rotation, axis_deg=0.0, width_px=32, height_px=32)
        loaded = load_series(write_simulated_series(tmp_path / "out", *simulate("spheres", options)))
        metadata = loaded.views[0].metadata
        assert metadata.raw["DP_SCAN_ROT"] == f"Scan Rot = {switch}"
        assert np.rad2deg(metadata.scan_rotation_rad) == pytest.approx(rotation)
        assert metadata.raw["DP_DETECTOR_TYPE"] == "Detector = SE2"


@pytest.mark.parametrize(
    ("axis_deg", "axis", "tilted"),
    [
        (0.0, "Tilt Axis =   0.0 °", "In Y"),
        (90.0, "Tilt Axis =  90.0 °", "in X"),
        (-30.0, "Tilt Axis = 330.0 °", "in X"),
    ],
)
def test_header_tells_the_tilt_axis_as_the_microscope_does(
    tmp_path: Path, axis_deg: float, axis: str, tilted: str
) -> None:
    options = replace(OPTIONS, axis_deg=axis_deg, width_px=32, height_px=32)
    loaded = load_series(write_simulated_series(tmp_path / "out", *simulate("spheres", options)))
    raw = loaded.views[0].metadata.raw
    assert (raw["AP_TILT_AXIS"], raw["DP_STAGE_TILTED"]) == (axis, f"Stage Tilt = {tilted}")
    # About a horizontal axis, and about no other, the sign of a Zeiss stage is known.
    assert any("the sign of this Zeiss stage's tilt is assumed" in text for text in loaded.warnings) == (axis_deg != 0)


def test_a_mesh_is_written_whole_and_empty_places_are_unknown(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    specimen = MeshSpecimen("ball", np.asarray(ball.vertices), np.asarray(ball.faces))
    options = replace(OPTIONS, width_px=48, height_px=48, working_distance_um=500.0, skew=0.01)
    folder = write_simulated_series(tmp_path / "out", *simulate(specimen, options))
    mesh = trimesh.load(folder / "truth_mesh.ply", process=False)
    assert (len(mesh.vertices), len(mesh.faces)) == (len(ball.vertices), len(ball.faces))
    truth = read_truth(folder)
    assert truth.working_distance_um == 500.0
    assert len(truth.skew) == 3
    assert 0 < np.abs(truth.skew).max() < 0.05
    assert np.isnan(truth.height_um[0, 0])
    assert not truth.visible[:, 0, 0].any()


def test_foreign_readers_find_the_zeiss_block(tmp_path: Path, simulation: tuple[TiltSeries, SimulationTruth]) -> None:
    folder = write_simulated_series(tmp_path / "out", *simulation)
    with tifffile.TiffFile(folder / "view_00_-06.00deg.tif") as tif:
        told = tif.sem_metadata
    assert told is not None
    assert told["ap_image_pixel_size"][1:] == (100.0, "nm")
    assert abs(told["ap_stage_at_t"][1]) == 6.0
    assert told["dp_image_store"][1] == "160 * 128"


def test_same_simulation_gives_the_same_files(tmp_path: Path, simulation: tuple[TiltSeries, SimulationTruth]) -> None:
    one = write_simulated_series(tmp_path / "one", *simulation)
    two = write_simulated_series(tmp_path / "two", *simulation)
    names = sorted(path.name for path in one.iterdir())
    assert names == sorted(path.name for path in two.iterdir())
    for name in names:
        assert (one / name).read_bytes() == (two / name).read_bytes(), name


def test_earlier_simulation_is_replaced_and_other_folders_are_refused(
    tmp_path: Path, simulation: tuple[TiltSeries, SimulationTruth]
) -> None:
    series, truth = simulation
    folder = write_simulated_series(tmp_path / "out", series, truth)
    fewer = simulate("spheres", replace(OPTIONS, tilts_deg=(-1.0, 1.0)))
    write_simulated_series(folder, *fewer)
    assert sorted(path.name for path in folder.glob("*.tif")) == ["view_00_-01.00deg.tif", "view_01_+01.00deg.tif"]
    (folder / "thesis.txt").write_text("keep me", encoding="utf-8")
    with pytest.raises(BadInputError, match=r"1 other file.*thesis\.txt"):
        write_simulated_series(folder, series, truth)
    assert read_truth(folder).motion.n_views == 2
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(BadInputError, match="a file stands in its place"):
        write_simulated_series(tmp_path / "file", series, truth)


def test_missing_or_damaged_truth_is_bad_input(tmp_path: Path, simulation: tuple[TiltSeries, SimulationTruth]) -> None:
    with pytest.raises(BadInputError, match="no readable truth"):
        read_truth(tmp_path)
    folder = write_simulated_series(tmp_path / "out", *simulation)
    (folder / "truth.npz").write_bytes(b"PK nonsense")
    with pytest.raises(BadInputError, match="no readable truth"):
        read_truth(folder)
