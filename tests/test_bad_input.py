"""Bad input of every kind through the command line: its exit code, its message, and no run left behind."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from semscape.cli import app
from semscape.io.simulated import write_simulated_series
from semscape.simulate import SimulationOptions, simulate

MICROSCOPE = SimulationOptions(tilts_deg=(-5.0, 0.0, 5.0), width_px=192, height_px=192)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bad-input") / "images"
    return write_simulated_series(folder, *simulate("fracture", MICROSCOPE, rng=0))


@pytest.fixture
def images(simulated: Path, tmp_path: Path) -> Path:
    """Three good views a.tif, b.tif, c.tif without any header."""
    folder = tmp_path / "images"
    folder.mkdir()
    for name, path in zip("abc", sorted(simulated.glob("*.tif")), strict=True):
        tifffile.imwrite(folder / f"{name}.tif", tifffile.imread(path))
    return folder


def reconstruct(folder: Path, output: Path, *arguments: object) -> Any:
    return CliRunner().invoke(app, [str(a) for a in ("reconstruct", folder, "-o", output, *arguments)])


def looks_like_a_run(output: Path) -> bool:
    return output.is_dir() and any(output.iterdir())


def assert_refused(done: Any, code: int, *messages: str, output: Path) -> None:
    assert done.exit_code == code, done.output
    for message in messages:
        assert message in done.stderr, done.stderr
    assert "Traceback" not in done.output
    assert done.stderr.count("semscape: error:") == 1
    assert done.stdout == ""
    assert not looks_like_a_run(output)


def test_good_input_ends_with_0(images: Path, tmp_path: Path) -> None:
    done = reconstruct(images, tmp_path / "run", "--tilts", "-5,0,5")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "run" / "report.json").is_file()


def test_an_empty_folder(tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    done = reconstruct(folder, tmp_path / "run")
    assert_refused(done, 2, "no images in this folder", str(folder), output=tmp_path / "run")


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    done = reconstruct(tmp_path / "nowhere", tmp_path / "run")
    assert_refused(done, 2, "there is no such folder", output=tmp_path / "run")


def test_a_file_instead_of_a_folder(images: Path, tmp_path: Path) -> None:
    done = reconstruct(images / "a.tif", tmp_path / "run")
    assert_refused(done, 2, "this is a file; give the folder", output=tmp_path / "run")


def test_one_image(images: Path, tmp_path: Path) -> None:
    (images / "b.tif").unlink()
    (images / "c.tif").unlink()
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "only one image (a.tif)", "at least two", output=tmp_path / "run")


def test_two_images_without_tilts(images: Path, tmp_path: Path) -> None:
    (images / "c.tif").unlink()
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "bas-relief", "--tilts", "a.tif", "b.tif", "third view", output=tmp_path / "run")


def test_two_images_with_one_tilt(images: Path, tmp_path: Path) -> None:
    (images / "c.tif").unlink()
    (images / "series.toml").write_text('[images."a.tif"]\ntilt_deg = -5\n')
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "(a.tif, b.tif) without a stage tilt of b.tif", "bas-relief", output=tmp_path / "run")
    assert "estimated from the images" not in done.stderr


def test_two_images_with_tilts_are_fine(images: Path, tmp_path: Path) -> None:
    (images / "b.tif").unlink()
    done = reconstruct(images, tmp_path / "run", "--tilts", "-5,5")
    assert done.exit_code == 0, done.output


def test_a_text_file_named_tif(images: Path, tmp_path: Path) -> None:
    (images / "notes.tif").write_text("acquired on Monday, 5 kV\n")
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "notes.tif: not an image that can be read", output=tmp_path / "run")


def test_an_empty_file(images: Path, tmp_path: Path) -> None:
    (images / "b.tif").write_bytes(b"")
    assert_refused(reconstruct(images, tmp_path / "run"), 2, "b.tif", "0 bytes", output=tmp_path / "run")


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_a_truncated_tiff(images: Path, tmp_path: Path, share: float) -> None:
    data = (images / "b.tif").read_bytes()
    (images / "b.tif").write_bytes(data[: int(share * len(data))])
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "b.tif", output=tmp_path / "run")
    assert any(word in done.stderr for word in ("truncated", "damaged", "incomplete")), done.stderr


def test_images_of_different_sizes(images: Path, tmp_path: Path) -> None:
    tifffile.imwrite(images / "c.tif", tifffile.imread(images / "c.tif")[:-10])
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "different sizes", "c.tif is 192 x 182", "192 x 192", output=tmp_path / "run")


def test_an_all_black_image(images: Path, tmp_path: Path) -> None:
    tifffile.imwrite(images / "b.tif", np.zeros((192, 192), np.uint8))
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "b.tif", "one single value (0)", output=tmp_path / "run")


def test_three_identical_images(images: Path, tmp_path: Path) -> None:
    for name in "bc":
        shutil.copy(images / "a.tif", images / f"{name}.tif")
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "a.tif and b.tif hold the very same image", output=tmp_path / "run")


def test_three_images_of_one_tilt(images: Path, tmp_path: Path) -> None:
    """The same picture three times, but for the noise: no header gives it away."""
    still = SimulationOptions(tilts_deg=(0.0, 0.0, 0.0), width_px=192, height_px=192, stage_error_deg=0.0)
    series, _ = simulate("fracture", still, rng=0)
    for name, view in zip("abc", series.views, strict=True):
        tifffile.imwrite(images / f"{name}.tif", view.image.astype(np.uint8))
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 3, "tilt farther", output=tmp_path / "run")


def test_equal_tilts_have_no_answer(images: Path, tmp_path: Path) -> None:
    done = reconstruct(images, tmp_path / "run", "--tilts", "5,5,5")
    assert_refused(done, 2, "a.tif and b.tif are both at 5 deg", output=tmp_path / "run")


def test_images_of_two_specimens(images: Path, tmp_path: Path) -> None:
    (images / "c.tif").unlink()
    stranger, _ = simulate("pollen", MICROSCOPE, rng=5)
    tifffile.imwrite(images / "b.tif", stranger.views[1].image.astype(np.uint8))
    done = reconstruct(images, tmp_path / "run", "--tilts", "-5,5")
    assert_refused(done, 3, "one specimen", "a.tif", "b.tif", output=tmp_path / "run")


def test_images_of_three_specimens(images: Path, tmp_path: Path) -> None:
    for name, specimen in (("b", "pollen"), ("c", "vickers")):
        stranger, _ = simulate(specimen, MICROSCOPE, rng=5)
        tifffile.imwrite(images / f"{name}.tif", stranger.views[1].image.astype(np.uint8))
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 3, "no two of the 3 views", output=tmp_path / "run")


def test_two_views_left_of_three_without_tilts(images: Path, tmp_path: Path) -> None:
    """What is left after strangers are put out passes the same gate as what was given, and they are named."""
    strangers, _ = simulate("pollen", MICROSCOPE, rng=5)
    tifffile.imwrite(images / "c.tif", strangers.views[0].image.astype(np.uint8))
    left_out = "left out, because no match ties them to the other views: "
    run = tmp_path / "run"
    done = reconstruct(images, run)
    assert_refused(done, 2, f"{left_out}c.tif (another", "(a.tif, b.tif)", "bas-relief", output=run)
    # Strangers that match each other are no less strangers.
    tifffile.imwrite(images / "d.tif", strangers.views[2].image.astype(np.uint8))
    done = reconstruct(images, run)
    assert_refused(done, 2, f"{left_out}c.tif, d.tif (another", "bas-relief", output=run)


def test_pure_noise(images: Path, tmp_path: Path) -> None:
    for seed, name in enumerate("abc"):
        noise = np.random.default_rng(seed).integers(0, 255, (192, 192), dtype=np.uint8)
        tifffile.imwrite(images / f"{name}.tif", noise)
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 3, "no two of the 3 views", output=tmp_path / "run")


@pytest.mark.parametrize("value", ["nan", "-0.05", "0", "inf"])
def test_a_pixel_size_that_is_none(images: Path, tmp_path: Path, value: str) -> None:
    done = reconstruct(images, tmp_path / "run", "--pixel-size-um", value)
    assert_refused(done, 2, "--pixel-size-um must be a positive number", output=tmp_path / "run")


@pytest.mark.parametrize("text", ["-0.05", "0.0"])
def test_a_pixel_size_that_is_none_in_other_places(images: Path, tmp_path: Path, text: str) -> None:
    done = reconstruct(images, tmp_path / "run", "--set", f"input.pixel_size_um={text}")
    assert_refused(done, 2, "the pixel size given", "positive number", output=tmp_path / "run")
    (images / "series.toml").write_text(f"pixel_size_um = {text}\n")
    done = reconstruct(images, tmp_path / "run")
    assert_refused(done, 2, "pixel_size_um", "series.toml", output=tmp_path / "run")


def test_a_nan_pixel_size_in_the_series_file(images: Path, tmp_path: Path) -> None:
    (images / "series.toml").write_text("pixel_size_um = nan\n")
    done = reconstruct(images, tmp_path / "run", "--tilts", "-5,0,5")
    assert_refused(done, 2, "pixel_size_um", "series.toml", output=tmp_path / "run")


@pytest.mark.parametrize("tilts", ["-5,5", "-5,0,5,10", "5"])
def test_a_tilts_list_of_the_wrong_length(images: Path, tmp_path: Path, tilts: str) -> None:
    done = reconstruct(images, tmp_path / "run", "--tilts", tilts)
    assert_refused(done, 2, "tilt", "3 images", output=tmp_path / "run")


def test_a_file_in_the_way_of_the_output(images: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    output.write_text("mine")
    done = reconstruct(images, output)
    assert_refused(done, 2, "a file stands in its place", str(output), output=output)
    assert output.read_text() == "mine"
    below = reconstruct(images, output / "deeper")
    assert_refused(below, 2, "a file stands in its place", output=output / "deeper")


def test_a_folder_of_other_things_as_output(images: Path, tmp_path: Path) -> None:
    done = reconstruct(images, images)
    assert (done.exit_code, "not an earlier run" in done.stderr) == (2, True)
    assert sorted(path.name for path in images.iterdir()) == ["a.tif", "b.tif", "c.tif"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not bind this user")
def test_an_output_that_may_not_be_written(images: Path, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    try:
        done = reconstruct(images, locked / "run")
        assert_refused(done, 2, "cannot be", str(locked), output=locked / "run")
    finally:
        locked.chmod(0o755)


def test_an_output_that_no_system_can_make(images: Path, tmp_path: Path) -> None:
    done = reconstruct(images, tmp_path / ("x" * 300))
    assert_refused(done, 2, "the output folder", output=tmp_path / "run")


def test_a_failed_run_leaves_an_earlier_one_as_it_was(images: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    assert reconstruct(images, output, "--tilts", "-5,0,5", "-q").exit_code == 0
    before = {path.name: path.read_bytes() for path in output.iterdir()}
    tifffile.imwrite(images / "b.tif", np.zeros((192, 192), np.uint8))
    assert reconstruct(images, output, "--tilts", "-5,0,5").exit_code == 2
    assert {path.name: path.read_bytes() for path in output.iterdir()} == before
    assert json.loads(before["report.json"])["verdict"]


def test_the_real_command_ends_the_same_way(images: Path, tmp_path: Path) -> None:
    """In a process of its own: exit codes and streams as a shell sees them, and a traceback with --debug alone."""
    tifffile.imwrite(images / "b.tif", np.zeros((192, 192), np.uint8))
    command = [sys.executable, "-m", "semscape", "reconstruct", str(images), "-o", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("semscape: error: ")
    assert len(done.stderr.splitlines()) == 1
    debug = subprocess.run([*command, "--debug"], capture_output=True, text=True, check=False)
    assert debug.returncode == 2
    assert "Traceback" in debug.stderr
