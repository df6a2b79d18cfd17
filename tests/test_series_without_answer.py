"""Series that cannot be calibrated, or not by all views, through the whole pipeline: what a user is told."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from scipy.ndimage import map_coordinates
from typer.testing import CliRunner

from semscape.cli import app
from semscape.simulate import SimulationOptions, Specimen, simulate
from semscape.types import FloatArray

MICROSCOPE = SimulationOptions(width_px=224, height_px=224)
FLAT = Specimen("flat", np.zeros((64, 64), np.float32), 2.0, 7)


def images(
    folder: Path,
    specimen: str | Specimen,
    tilts_deg: tuple[float, ...],
    spoil: Callable[[int, FloatArray], FloatArray] = lambda _, image: image,
) -> Path:
    """Write bare images, without a header that tells anything."""
    series, _ = simulate(specimen, replace(MICROSCOPE, tilts_deg=tilts_deg), rng=3)
    folder.mkdir()
    for index, view in enumerate(series.views):
        grey = np.clip(np.rint(spoil(index, view.image)), 0, 255).astype(np.uint8)
        tifffile.imwrite(folder / f"view_{index}.tif", grey)
    return folder


def reconstruct(folder: Path, *options: str) -> Any:
    run = folder.with_name(f"{folder.name}-run")
    return CliRunner().invoke(app, ["reconstruct", str(folder), "-o", str(run), *options]), run


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return images(tmp_path_factory.mktemp("flat") / "images", FLAT, (-6.0, 0.0, 6.0))


def test_a_flat_specimen_cannot_calibrate_itself(flat: Path) -> None:
    done, run = reconstruct(flat)
    assert done.exit_code == 3
    told = " ".join(done.stderr.split())
    assert "no parallax: about a common affine map the points of any two of 3 views spread by at most 0." in told
    assert "the specimen is flat" in told
    assert "self-calibration is impossible): give the stage tilts (--tilts)" in told
    assert not (run / "report.json").exists()


def test_told_tilts_of_a_flat_specimen_carry_a_warning(flat: Path) -> None:
    done, run = reconstruct(flat, "--tilts=-6,0,6")
    assert done.exit_code == 0, done.output
    report = json.loads((run / "report.json").read_text(encoding="utf-8"))
    assert "no parallax: about a common affine map" in report["verdict"]
    height = report["metrics"]["height_range"]
    assert height < 0.15 * MICROSCOPE.width_px  # px: pits and hills of noise at most


def test_tilts_that_are_wrong_by_far_are_named_before_the_axis_they_have_turned(tmp_path: Path) -> None:
    done, run = reconstruct(images(tmp_path / "images", "fracture", (-5.0, 0.0, 5.0)), "--tilts=-40,0,40")
    assert done.exit_code == 0, done.output
    verdict = json.loads((run / "report.json").read_text(encoding="utf-8"))["verdict"]
    assert verdict.startswith("do not measure: the images contradict what was told of them. the tilts -40.0, 0.0, 40.0")
    assert "swapped files or a wrong axis?" in verdict


def test_too_small_a_tilt_range_is_refused_or_warned_of(tmp_path: Path) -> None:
    small = images(tmp_path / "small", "fracture", (-1.0, 0.0, 1.0))
    done, _ = reconstruct(small, "--tilts=-0.05,0,0.05")
    assert done.exit_code == 3
    assert "the stage tilts span 0.10 deg, need 0.2" in " ".join(done.stderr.split())
    done, run = reconstruct(small, "--tilts=-1,0,1")
    assert done.exit_code == 0, done.output
    report = json.loads((run / "report.json").read_text(encoding="utf-8"))
    assert any("height scale known to +-1" in text and "tilt farther" in text for text in report["warnings"])
    # Readings of 0.1 deg at -1 and 1 deg: 0.1 sqrt(2) / 2, of which the images take off little.
    assert 0.05 < report["metrics"]["height_scale_relative_sigma"] < 0.075


def test_one_picture_taken_three_times_has_no_parallax(tmp_path: Path) -> None:
    done, _ = reconstruct(images(tmp_path / "same", "fracture", (0.0, 1e-4, 2e-4)))
    assert done.exit_code == 3
    assert "The images are the same picture" in " ".join(done.stderr.split())


def test_a_specimen_that_bends_in_one_view_is_left_out_and_named(tmp_path: Path) -> None:
    """Charging shifts parts of one image by up to 5 px."""

    def bend(index: int, image: FloatArray) -> FloatArray:
        if index != 3:
            return image
        row, col = np.indices(image.shape, dtype=np.float64)
        moved = [row + 5 * np.sin(col / 40), col + 5 * np.sin(row / 40)]
        return map_coordinates(image, moved, order=1, mode="nearest")

    folder = images(tmp_path / "bent", "fracture", (-6.0, -3.0, 0.0, 3.0, 6.0), bend)
    done, run = reconstruct(folder, "--tilts=-6,-3,0,3,6")
    assert done.exit_code == 0, done.output
    report = json.loads((run / "report.json").read_text(encoding="utf-8"))
    assert any("view_3.tif" in text and "left out" in text for text in report["warnings"])
    told = json.loads((run / "reconstruction.json").read_text(encoding="utf-8"))
    assert [view["name"] for view in told["views"]] == [f"view_{index}.tif" for index in (0, 1, 2, 4)]
