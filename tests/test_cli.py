"""The command line where it needs no pipeline: usage, bad input, exit codes, what overrides what."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

import semscape
from semscape.cli import app
from semscape.errors import TooFewMatchesError
from semscape.options import Options, read_toml
from synthetic_result import make_result

RESULT = make_result()


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for name in "abc":
        tifffile.imwrite(folder / f"{name}.tif", rng.integers(0, 255, (48, 64), dtype=np.uint8))
    return folder


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Stand in for the pipeline: note what it is asked for, and answer with the synthetic result."""
    asked: dict[str, Any] = {}

    def reconstruct(series: Any, options: Options, **keywords: Any) -> Any:
        asked.update(series=series, options=options, **keywords)
        if "error" in asked:
            raise asked["error"]
        keywords["progress"]("detect", None)
        keywords["progress"]("detect", {"keypoints": 12})
        return RESULT

    # The page and its pictures have their own tests, and take half a second.
    monkeypatch.setattr("semscape.report.run.render_html", lambda _: "<!DOCTYPE html>")
    monkeypatch.setattr("semscape.batch.folder_run.reconstruct", reconstruct)
    return asked


def test_version_and_help() -> None:
    assert run("--version").output == f"semscape {semscape.__version__}\n"
    for command in ("reconstruct", "inspect", "simulate", "demo"):
        assert command in run("--help").output
        assert run(command, "--help").exit_code == 0


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys, semscape.cli\n"
        "try: semscape.cli.app(['--help'])\n"
        "except SystemExit: pass\n"
        "print([m for m in ('numpy', 'scipy', 'cv2', 'numba', 'matplotlib', 'trimesh') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_python_m_semscape_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "semscape", "--version"], capture_output=True, encoding="utf-8", check=False
    )
    assert (done.returncode, done.stdout) == (0, f"semscape {semscape.__version__}\n")


def test_a_run_writes_its_folder_and_says_where_the_report_is(images: Path, tmp_path: Path, seen) -> None:
    output = tmp_path / "run"
    done = run("reconstruct", images, "-o", output)
    assert done.exit_code == 0, done.output
    assert (output / "report.html").is_file()
    assert f"report: {output / 'report.html'}" in done.stdout
    assert "detect: 0.0 s; keypoints 12" in done.stderr
    assert "warning: grain_c.tif" in done.stderr
    assert seen["workers"] is None


def test_quiet_prints_nothing(images: Path, tmp_path: Path, seen) -> None:
    assert run("reconstruct", images, "-o", tmp_path / "run", "--quiet").output == ""


@pytest.mark.parametrize("tilts", [["--tilts", "-7,0,7"], ["--tilts=-7,0,7"], ["--tilts", "-7, 0, +7.0"]])
def test_tilts_may_begin_with_a_minus(images: Path, tmp_path: Path, seen, tilts: list[str]) -> None:
    done = run("reconstruct", *tilts, images, "-o", tmp_path / "run")
    assert done.exit_code == 0, done.output
    assert seen["options"].input.tilts_deg == (-7.0, 0.0, 7.0)
    np.testing.assert_allclose(np.rad2deg(seen["series"].tilt_rad), [-7, 0, 7])


def test_flags_override_settings_and_settings_override_the_file(images: Path, tmp_path: Path, seen) -> None:
    file = tmp_path / "options.toml"
    file.write_text(
        "[input]\npixel_size_um = 0.3\n[sfm]\nprior_tilt_deg = 0.7\nprior_scale = 0.5\n[run]\nseed = 9\n",
        encoding="utf-8",
    )
    base = ("reconstruct", images, "--options", file)
    assert run(*base, "-o", tmp_path / "a").exit_code == 0
    assert (seen["rng"], seen["options"].input.pixel_size_um, seen["options"].sfm.prior_scale) == (9, 0.3, 0.5)
    flags = ("--set", "sfm.prior_tilt_deg=0.2", "--seed", 4, "--set", "input.pixel_size_um=0.4")
    done = run(*base, "-o", tmp_path / "b", *flags, "--pixel-size-um", 0.1, "--invert-relief", "--workers", 2)
    assert done.exit_code == 0, done.output
    options = seen["options"]
    assert (options.sfm.prior_tilt_deg, options.sfm.prior_scale, options.sfm.invert_relief) == (0.2, 0.5, True)
    assert (options.input.pixel_size_um, options.run.seed, seen["rng"], seen["workers"]) == (0.1, 4, 4, 2)


def test_without_flags_the_options_are_the_defaults(images: Path, tmp_path: Path, seen) -> None:
    run("reconstruct", images, "-o", tmp_path / "run")
    assert seen["options"].to_toml() == Options().to_toml()
    written = (tmp_path / "run" / "options.toml").read_text(encoding="utf-8")
    assert read_toml(written).to_toml() == Options().to_toml()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--pixel-size-um", "nan"], "--pixel-size-um must be a positive number, got nan"),
        (["--pixel-size-um", "-0.05"], "--pixel-size-um must be a positive number, got -0.05"),
        (["--pixel-size-um", "inf"], "--pixel-size-um must be a positive number, got inf"),
        (["--axis-deg", "nan"], "--axis-deg must be an angle in deg"),
        (["--tilts", "-7,0"], "2 tilts for 3 images"),
        (["--tilts", "-7,x,7"], "--tilts '-7,x,7' is not a list of numbers"),
        (["--tilts", "-7,nan,7"], "is not a list of numbers"),
        (["--set", "sfm.prior_tilt=1"], "the nearest one is 'prior_tilt_deg'"),
        (["--set", "sfm.prior_tilt_deg=0"], "option sfm.prior_tilt_deg is 0, must be > 0"),
        (["--set", "sfm"], "not of the form stage.key=value"),
        (["--options", "missing.toml"], "the options file missing.toml cannot be read"),
        (["--seed", "-1"], "'--seed'"),
        (["--workers", "0"], "'--workers'"),
        (["--colour"], "--colour"),
    ],
)
def test_bad_flags_end_with_2_and_one_message(images: Path, tmp_path: Path, seen, arguments, message) -> None:
    done = run("reconstruct", images, "-o", tmp_path / "run", *arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert done.stdout == ""
    assert "options" not in seen


def test_an_options_file_that_is_no_text_is_refused(images: Path, tmp_path: Path) -> None:
    file = tmp_path / "options.toml"
    file.write_bytes(b"\xff\xfe\x00")
    done = run("reconstruct", images, "-o", tmp_path / "run", "--options", file)
    assert (done.exit_code, "is not text in UTF-8" in done.stderr) == (2, True)


def test_an_output_that_cannot_be_written_is_said_before_the_work_starts(images: Path, tmp_path: Path, seen) -> None:
    file = tmp_path / "run"
    file.write_text("", encoding="utf-8")
    for output, message in ((file, "a file stands in its place"), (images, "not an earlier run")):
        done = run("reconstruct", images, "-o", output)
        assert done.exit_code == 2
        assert message in done.stderr
        assert str(output) in done.stderr
    assert not seen


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (TooFewMatchesError("11 matches between a.tif and b.tif, need 24"), 3, "11 matches between a.tif and b.tif"),
        (ValueError("workers must be positive"), 2, "workers must be positive"),
        (
            np.linalg.LinAlgError("Singular matrix"),
            1,
            "unexpected LinAlgError: Singular matrix; run again with --debug",
        ),
        (KeyError("axis"), 1, "unexpected KeyError: 'axis'; run again with --debug"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_goes_wrong_has_its_exit_code(images: Path, tmp_path: Path, seen, error, code, message) -> None:
    seen["error"] = error
    done = run("reconstruct", images, "-o", tmp_path / "run")
    assert done.exit_code == code
    assert message in done.stderr
    assert "Traceback" not in done.output


def test_debug_shows_the_traceback(images: Path, tmp_path: Path, seen) -> None:
    seen["error"] = KeyError("axis")
    done = run("reconstruct", images, "-o", tmp_path / "run", "--debug")
    assert done.exit_code == 1
    assert "Traceback" in done.stderr


def test_inspect_shows_each_value_with_its_source(images: Path) -> None:
    done = run("inspect", images, "--tilts", "-7,0,7")
    assert done.exit_code == 0, done.output
    assert "3 views of 64 × 48 px" in done.stdout
    assert "-7° (user)" in done.stdout
    assert "lengths will be in px" in done.stdout
    assert "no tilts" not in done.stdout


def test_inspect_says_what_becomes_of_views_without_tilts(images: Path) -> None:
    assert "no tilts: found from the images" in run("inspect", images).stdout
    (images / "c.tif").unlink()
    done = run("inspect", images)
    assert done.exit_code == 0
    assert "warning: two views (a.tif, b.tif) without stage tilts" in done.stdout
    assert "no tilts" not in done.stdout
    assert "bas-relief" in json.loads(run("inspect", images, "--json").stdout)["warnings"][-1]
    assert "bas-relief" not in run("inspect", images, "--tilts", "-3,3").stdout


def test_inspect_speaks_json(images: Path) -> None:
    described = json.loads(run("inspect", images, "--pixel-size-um", 0.25, "--json").stdout)
    assert [view["name"] for view in described["views"]] == ["a.tif", "b.tif", "c.tif"]
    assert described["views"][0]["pixel_size_um"] == 0.25
    assert described["views"][0]["sources"]["pixel_size_um"] == "user"


def test_inspect_writes_what_it_understood_once(images: Path) -> None:
    assert run("inspect", images, "--write", "--pixel-size-um", 0.25).exit_code == 0
    assert "# pixel_size_um = 0.25" in (images / "series.toml").read_text()
    again = run("inspect", images, "--write")
    assert again.exit_code == 2
    assert "not overwritten" in again.stderr


def test_a_scale_bar_that_is_not_there(images: Path) -> None:
    done = run("inspect", images, "--scale-bar-um", 40)
    assert done.exit_code == 2
    assert "no scale bar" in done.stderr


def test_inspect_names_files_that_may_be_images_without_a_suffix(images: Path) -> None:
    for name in ("notes.txt", "a.hdr", "truth.bin", ".hidden", "series.toml"):
        (images / name).touch()
    (images / "folder").mkdir()
    assert "ignored" not in run("inspect", images).stdout
    (images / "a.tif.bak").touch()  # and so would be an image of a kind that is not read, like .webp
    described = json.loads(run("inspect", images, "--json").stdout)
    assert "ignored: a.tif.bak (read are .tif, .tiff, .png, .jpg, .jpeg, .bmp)" in described["warnings"]
    assert not [text for view in described["views"] for text in view["warnings"] if "ignored" in text]
    for index in range(1, 7):
        (images / f"scan{index}").touch()
    shown = run("inspect", images).stdout
    assert "ignored: a.tif.bak, scan1, scan2, scan3, scan4 and 2 more (read are .tif, " in shown


def test_inspect_names_what_is_wrong(tmp_path: Path) -> None:
    done = run("inspect", tmp_path)
    assert (done.exit_code, "no images in this folder" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["vikers"], "vickers"),
        (["--preset", "best"], "there are: ideal, nominal, hard"),
        (["--tilts", "1,2", "--views", "3"], "leave out --views and --step"),
        (["--step", "-1"], "--step must be a positive number"),
        (["--size", "12px"], "is not a size in px"),
        (["--size", "4"], "at least 16 x 16 px"),
        (["--tilts", "80"], "within"),
        (["--views", "1"], "'--views'"),
        (["--tilts", "3"], "at least 2 views"),
        (["--detector", "edx"], "one of se, bse-3, bse-4"),
        (["--dose", "-1"], "'--dose'"),
        (["--set", "drift=1"], "the nearest key is 'drift_px'"),
        (["--set", "drift_px"], "the form is KEY=VALUE"),
        (["--set", "drift_px=much"], "drift_px takes a number, not 'much'"),
        (["missing.stl"], "there is no such file"),
        (["--size", "40000"], "at most 36 megapixels"),
        (["--set", "samples=1000"], "samples must be within 1 and 16"),
        (["--pixel-size-um", "1e300"], "pixel_size_um must be within 1e-06 and 1e+06 um"),
    ],
)
def test_bad_simulations_end_with_2(tmp_path: Path, arguments: list[str], message: str) -> None:
    done = run("simulate", *arguments, "-o", tmp_path / "series")
    assert done.exit_code == 2
    assert message in done.stderr


def test_simulate_looks_at_the_folder_before_it_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("semscape.simulate.acquire", lambda **_: pytest.fail("worked for nothing"))
    (tmp_path / "thesis.txt").touch()
    done = run("simulate", "vickers", "-o", tmp_path)
    assert (done.exit_code, "thesis.txt" in done.stderr) == (2, True)
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere
    done = run("simulate", "vickers", "-o", tmp_path / "new" / "folder")
    assert done.exit_code == 2
    assert f"no permission to write in {tmp_path}" in done.stderr


def test_simulate_writes_a_series_that_inspect_understands(tmp_path: Path) -> None:
    folder = tmp_path / "series"
    done = run("simulate", "vickers", "-o", folder, "--size", "64x48", "--views", 3, "--step", 4, "--seed", 1)
    assert done.exit_code == 0, done.output
    assert f"3 views in {folder}" in done.stdout
    assert json.loads((folder / "truth.json").read_text(encoding="utf-8"))["seed"] == 1
    views = json.loads(run("inspect", folder, "--json").stdout)["views"]
    assert [view["tilt_deg"] for view in views] == [-4.0, 0.0, 4.0]
    assert (views[0]["width"], views[0]["height"]) == (64, 48)


def test_simulate_images_a_file_of_ones_own_by_each_segment(tmp_path: Path) -> None:
    heights = np.fromfunction(lambda row, col: 0.3 * np.sin(row / 5) * np.cos(col / 7), (120, 160))
    np.savez(tmp_path / "waves.npz", height_um=heights, pixel_size_um=0.2)
    folder = tmp_path / "series"
    settings = ("--dose", 50, "--set", "charging=0", "--set", "tilts_deg=-2,2", "--set", "working_distance_um=2000")
    done = run("simulate", tmp_path / "waves.npz", "-o", folder, "--size", 64, "--detector", "bse-3", *settings)
    assert done.exit_code == 0, done.output
    told = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert told["settings"]["specimen"] == "waves.npz"
    assert (told["settings"]["charging"], told["settings"]["dose"], told["working_distance_um"]) == (0, 50, 2000)
    assert told["pixel_size_um"] == pytest.approx(119 * 0.2 / 64 / 1.1)
    assert [view["stage_tilt_deg"] for view in told["views"]] == pytest.approx([-2, 2])
    parts = sorted(path.name for path in (folder / "segments").iterdir())
    assert parts == [f"view_{v:02d}_{t}deg_{s}.tif" for v, t in enumerate(("-02.00", "+02.00")) for s in "ABC"]
    views = json.loads(run("inspect", folder, "--json").stdout)["views"]
    assert [view["tilt_deg"] for view in views] == [-2.0, 2.0]
    # The same folder again, without segments: none of the old ones stay.
    assert run("simulate", "-o", folder, "--size", 32).exit_code == 0
    assert not (folder / "segments").exists()


def test_simulate_fills_the_folder_one_stands_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for views in (3, 2):
        done = run("simulate", "-o", ".", "--size", "32", "--views", views)
        assert done.exit_code == 0, done.output
        assert len(list(Path.cwd().glob("*.tif"))) == views
    assert not list(tmp_path.glob(".*"))


def test_simulate_keeps_foreign_files(tmp_path: Path) -> None:
    (tmp_path / "holiday.tif").write_text("", encoding="utf-8")
    done = run("simulate", "-o", tmp_path, "--size", "32")
    assert done.exit_code == 2
    assert "holiday.tif" in done.stderr
    assert (tmp_path / "holiday.tif").exists()


def test_keep_says_what_is_kept(images: Path, tmp_path: Path, seen: dict[str, Any]) -> None:
    ended = run("reconstruct", images, "-o", tmp_path / "run", "--tilts", "-3,0,3", "--keep", "specimen")
    assert ended.exit_code == 0, ended.output
    assert seen["options"].dense.keep == "specimen"
    ended = run("reconstruct", images, "-o", tmp_path / "other", "--tilts", "-3,0,3", "--keep", "specimens")
    assert ended.exit_code == 2
    assert "the nearest one is 'specimen'" in ended.output


def test_a_full_object_tells_before_the_work_what_is_doubtful_in_its_files(images: Path, tmp_path: Path) -> None:
    """One file is no image; and one image has no tilt, which is told before it is refused."""
    stage = [f'[images."{name}.tif"]\ntilt_deg = {tilt}\nstage_rotation_deg = 0' for name, tilt in (("a", 0), ("b", 6))]
    (images / "series.toml").write_text("\n".join(stage))
    (images / "field.dat").write_bytes(b"?")
    doubtful = json.loads(run("inspect", images, "--json").stdout)["warnings"]
    assert [text.split(";")[0] for text in doubtful] == [
        "ignored: field.dat (read are .tif, .tiff, .png, .jpg, .jpeg, .bmp)",
        "no tilt is known for c.tif",
    ]
    told = run("reconstruct", images, "-o", tmp_path / "run", "--full-object")
    assert "c.tif: a full object needs the tilt" in told.stderr
    said = [line.removeprefix("warning: ") for line in told.stderr.splitlines() if line.startswith("warning: ")]
    assert said == doubtful
