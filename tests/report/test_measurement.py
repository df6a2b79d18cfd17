"""What `semscape measure` shows and writes: every value with its unit, and the same numbers everywhere."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from semscape.cli import app
from semscape.errors import BadInputError
from semscape.io.finished_run import read_finished_run
from semscape.io.surfaces import encode_height_map_npz
from semscape.metrology.request import MeasureRequest
from semscape.options import MeasureOptions, Options
from semscape.report.measurement import measure_run, print_measurement, write_measurement
from semscape.types import HeightMap


def write_run(
    folder: Path, *, ambiguity: str = "none", verdict: str = "good: heights to +-2 %", unit: str = "um"
) -> Path:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    rows, cols = np.indices((90, 120))
    z = 0.3 * np.sin(cols / 5) + 0.01 * rows + np.where(cols > 60, 1.0, 0.0) + rng.normal(0, 0.02, rows.shape)
    z[:3] = np.nan
    height_map = HeightMap(
        z, np.full(z.shape, 0.02), np.full(z.shape, 3, np.uint8), np.zeros(z.shape, np.float32), 0.25,
        np.diag([0.25, -0.25, 1, 1]), unit,
    )  # fmt: skip
    (folder / "height_map.npz").write_bytes(encode_height_map_npz(height_map))
    reconstruction = {"height_scale_relative_sigma": 0.012, "ambiguity": ambiguity}
    (folder / "reconstruction.json").write_text(json.dumps(reconstruction))
    (folder / "report.json").write_text(json.dumps({"verdict": verdict}))
    (folder / "options.toml").write_text(Options().to_toml())
    return folder


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run")


REQUEST = MeasureRequest(MeasureOptions(draws=4), profile=(5.0, 40.0, 110.0, 40.0))


def shown(measured) -> str:
    text = io.StringIO()
    print_measurement(measured, Console(file=text, width=160, highlight=False))
    return text.getvalue()


def test_a_run_says_how_far_its_heights_can_be_trusted(run_folder: Path) -> None:
    run = read_finished_run(run_folder)
    assert run.height_scale_relative_sigma == 0.012
    assert (run.ambiguity, run.verdict[:5]) == ("none", "good:")
    assert run.height_map.pixel_size_um == 0.25
    alone = read_finished_run(run_folder / "height_map.npz")
    assert np.isnan(alone.height_scale_relative_sigma)


def test_what_is_no_run_is_named(tmp_path: Path, run_folder: Path) -> None:
    with pytest.raises(BadInputError, match="does not exist"):
        read_finished_run(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInputError, match=r"holds no height_map\.npz"):
        read_finished_run(tmp_path / "empty")
    (run_folder / "reconstruction.json").write_text("{ broken")
    with pytest.raises(BadInputError, match=r"reconstruction\.json cannot be read"):
        read_finished_run(run_folder)
    (run_folder / "reconstruction.json").write_text("[]")
    with pytest.raises(BadInputError, match="does not hold a table"):
        read_finished_run(run_folder)


def test_the_table_shows_unit_and_sigma_with_every_value(run_folder: Path) -> None:
    text = shown(measure_run(read_finished_run(run_folder), REQUEST))
    for words in (
        "plane removed, S-filter none",
        "lateral resolution",
        "um³/um²",
        "height scale",
        "warning: there is no",
    ):
        assert words in text
    row = next(line for line in text.splitlines() if "Sq" in line and "root mean square height" in line)
    assert row.split("|")[2:5][2].strip() == "um"
    assert float(row.split("|")[3]) > 0


def test_warnings_of_the_run_come_first(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "bad", ambiguity="reflection", verdict="do not measure: the tilts contradict")
    warnings = measure_run(read_finished_run(folder), REQUEST).warnings
    assert warnings[0].startswith("do not measure")
    assert "sign of the relief is assumed" in warnings[1]


def test_json_csv_and_profile_hold_the_same_numbers(run_folder: Path, tmp_path: Path) -> None:
    measured = measure_run(read_finished_run(run_folder), REQUEST)
    write_measurement(measured, tmp_path / "new" / "folder")
    values = json.loads((tmp_path / "new" / "folder" / "measurement.json").read_text())
    assert values["length_unit"] == "um"
    assert values["pixel_size_um"] == 0.25
    assert values["lateral_period_limit_um"] == pytest.approx(measured.measurement.resolution.period)
    assert values["places_px"] == {"profile": [5.0, 40.0, 110.0, 40.0]}
    with (tmp_path / "new" / "folder" / "measurement.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [figure["name"] for figure in values["figures"]]
    for row, figure in zip(rows, values["figures"], strict=True):
        assert (float(row["value"]) if row["value"] else None) == figure["value"]
        assert row["unit"] == figure["unit"]
    profile = (tmp_path / "new" / "folder" / "profile.csv").read_text().splitlines()
    assert profile[0] == "distance_um,height_um"
    assert len(profile) == 1 + len(measured.measurement.profile.height)
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="cannot be made"):
        write_measurement(measured, tmp_path / "file")


def test_every_place_in_json_is_in_px(run_folder: Path) -> None:
    finished = read_finished_run(run_folder)
    request = MeasureRequest(MeasureOptions(draws=2), profile=(5, 40, 110, 40), edges=(13.0,))
    assert json.loads(measure_run(finished, request).json())["places_px"]["edges"] == [52.0]  # of 0.25 um


def test_the_command_measures_and_wear_of_a_run_against_itself_is_nothing(run_folder: Path, tmp_path: Path) -> None:
    arguments = ["measure", str(run_folder), "--s-filter-um", "5", "--step", "5,10,50,80;70,10,115,80", "--json"]
    done = CliRunner().invoke(app, [*arguments, "--since", str(run_folder), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    values = json.loads(done.stdout)
    figures = {f"{figure['group']}/{figure['name']}": figure for figure in values["figures"]}
    assert figures["step/height"]["sigma"] > 0
    assert figures["change/volume lost"]["value"] < 1e-6
    assert values["options"]["s_filter_um"] == 5
    assert (tmp_path / "out" / "measurement.csv").is_file()
    again = CliRunner().invoke(app, [*arguments, "--since", str(run_folder)])
    assert again.stdout == done.stdout


def test_lengths_of_a_run_without_a_pixel_size_are_in_px(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "px", unit="px")
    done = CliRunner().invoke(app, ["measure", str(folder)])
    assert done.exit_code == 0, done.output
    assert "px³/px²" in done.stdout
    assert "the run has no pixel size" in " ".join(done.stdout.split())
    assert " um" not in done.stdout.replace("--s-filter-um", "")
    wrong = CliRunner().invoke(app, ["measure", str(folder), "--profile", "1,2,30,40um"])
    assert wrong.exit_code == 2
    assert "no pixel size" in wrong.output
