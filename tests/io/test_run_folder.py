from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from semscape.errors import BadInputError
from semscape.io.run_folder import (
    RUN_FILES,
    encode_run,
    json_text,
    options_toml,
    prepare_run_folder,
    put_files,
    reconstruction_to_dict,
)
from semscape.options import Options, read_toml
from synthetic_result import make_result, with_reconstruction, with_report

RESULT = make_result()


def test_prepare_makes_a_folder_with_its_parents_and_leaves_it_empty(tmp_path) -> None:
    folder = prepare_run_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert not list(folder.iterdir())


def test_prepare_accepts_empty_folders_and_earlier_runs(tmp_path) -> None:
    for name in ("report.json", "reconstruction.json", "options.toml"):
        (tmp_path / name).write_text("{}")
    prepare_run_folder(tmp_path)


@pytest.mark.parametrize("below", ["", "run"])
def test_prepare_refuses_a_file_in_the_folders_place(tmp_path, below: str) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(BadInputError, match=r"output folder .*file.* cannot be made: a file stands in its place"):
        prepare_run_folder(file / below)


def test_prepare_refuses_a_folder_that_holds_something_else(tmp_path) -> None:
    (tmp_path / "thesis.docx").write_text("")
    with pytest.raises(BadInputError, match=r"not empty and is not an earlier run.*thesis\.docx.*give a new or empty"):
        prepare_run_folder(tmp_path)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="nothing is read-only for root or on Windows")
def test_prepare_refuses_a_read_only_folder(tmp_path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(BadInputError, match="cannot be written: Permission denied"):
        prepare_run_folder(tmp_path)


def test_prepare_refuses_a_folder_that_nothing_can_be_written_to(tmp_path, monkeypatch) -> None:
    def refuse(**_: object) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(BadInputError, match=r"output folder .* cannot be written: Permission denied"):
        prepare_run_folder(tmp_path)


def test_reconstruction_json_keeps_the_contract() -> None:
    values = json.loads(encode_run(RESULT)["reconstruction.json"])
    for key in ("axis_deg", "tilt_source", "height_scale_relative_sigma", "ambiguity", "rms_px", "n_tracks"):
        assert key in values
    assert values["length_unit"] == "um"
    view = values["views"][0]
    assert {"name", "tilt_deg", "tilt_sigma_deg", "roll_deg", "scale_px_per_um", "R", "t_px", "anisotropy"} <= set(view)
    assert view["tilt_deg"] == pytest.approx(-3.02)
    assert np.shape(view["R"]) == (3, 3)


def test_reconstruction_json_projects_the_points_as_the_cameras_do() -> None:
    from semscape.geometry.cameras import cameras_of

    points = RESULT.reconstruction.points_um
    views = reconstruction_to_dict(RESULT.reconstruction, RESULT.series.names)["views"]
    for view, camera in zip(views, cameras_of(RESULT.reconstruction.motion), strict=True):
        stretch = np.array([1 + view["anisotropy"] / 2, 1 - view["anisotropy"] / 2])
        projected = stretch * view["scale_px_per_um"] * (points @ np.asarray(view["R"])[:2].T) + view["t_px"]
        np.testing.assert_allclose(projected, camera.project(points), atol=1e-9)


def test_a_series_without_pixel_size_says_px_in_every_key() -> None:
    values = json.loads(encode_run(make_result("px"))["reconstruction.json"])
    assert values["length_unit"] == "px"
    assert "scale_px_per_px" in values["views"][0]
    assert not [key for key in values["views"][0] if key.endswith("_um")]


def test_unknown_values_are_null() -> None:
    unknown = with_reconstruction(RESULT, tilt_prior_rad=np.full(3, np.nan), height_scale_relative_sigma=np.inf)
    values = json.loads(encode_run(unknown)["reconstruction.json"])
    assert values["views"][0]["stage_tilt_deg"] is None
    assert values["height_scale_relative_sigma"] is None


def test_the_same_result_gives_the_same_bytes() -> None:
    assert encode_run(make_result()) == encode_run(make_result())


def test_options_toml_repeats_the_run() -> None:
    options = Options().with_values(
        {"input": {"tilts_deg": [-7, 0, 7]}, "run": {"seed": 3}, "sfm": {"prior_scale": 1e-5}}
    )
    text = encode_run(with_report(RESULT, options=options.to_dict()))["options.toml"].decode()
    assert read_toml(text).to_toml() == options.to_toml()
    assert read_toml(text).run.seed == 3


def test_options_that_went_through_json_are_read_as_well() -> None:
    plain = json.loads(json_text(Options().to_dict()))
    assert plain["input"]["pixel_size_um"] is None
    assert read_toml(options_toml(plain)).to_toml() == Options().to_toml()


def test_put_files_replaces_files_and_leaves_nothing_else(tmp_path) -> None:
    (tmp_path / "a.txt").write_text("old")
    put_files({"a.txt": b"new", "b.txt": b"b"}, tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.txt": "new", "b.txt": "b"}


def test_a_failing_write_leaves_the_earlier_run_untouched(tmp_path, monkeypatch) -> None:
    put_files({"a.txt": b"old", "b.txt": b"old"}, tmp_path)

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(BadInputError, match=r"cannot be written: No space left"):
        put_files({"a.txt": b"new", "b.txt": b"new"}, tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.txt": "old", "b.txt": "old"}


def test_what_a_killed_run_left_is_cleared(tmp_path) -> None:
    (tmp_path / ".semscape-partial-x").mkdir()
    (tmp_path / ".semscape-partial-x" / "mesh.ply").write_text("half")
    prepare_run_folder(tmp_path)
    assert not list(tmp_path.iterdir())


def test_json_text_refuses_what_is_not_json(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="has no place in a JSON file"):
        json_text({"folder": tmp_path})


def test_encode_run_and_the_reports_make_up_the_run_folder() -> None:
    assert {*encode_run(RESULT), "report.json", "report.html"} == set(RUN_FILES)


def test_owners_of_different_files_in_one_folder_do_not_clear_each_others(tmp_path: Path) -> None:
    """As two workers of a batch do, when one's record is ready while the other writes its own."""

    class Slow(dict[str, bytes]):
        def items(self):
            for owner in ("grain", "grain-1.a", "grain-1.aaaaaaaa"):
                put_files({f"{owner}.json": b"its own"}, tmp_path, owner)
            return super().items()

    (tmp_path / ".semscape-partial-grain-1.killed_1").mkdir()
    put_files(Slow({"grain-1.json": b"mine"}), tmp_path, "grain-1")
    names = ["grain-1.a.json", "grain-1.aaaaaaaa.json", "grain-1.json", "grain.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
