"""The table of detectors: its numbers on a series with truth, its forms, its command."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from semscape.cli import app
from semscape.errors import BadInputError
from semscape.experiments import features
from semscape.experiments.features_output import features_csv, features_json, features_table, features_text
from semscape.experiments.features_table import DetectorFigures, compare_features, compare_features_of
from semscape.experiments.study import Setting
from semscape.experiments.true_matches import true_match_px
from semscape.features.detect import DETECTORS
from semscape.geometry.cameras import cameras_of
from semscape.io.simulated import write_simulated_series
from semscape.options import Options
from semscape.simulate import PRESETS, simulate
from semscape.types import SimulationTruth, TiltSeries

Simulated = tuple[TiltSeries, SimulationTruth]


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    microscope = replace(PRESETS["nominal"], tilts_deg=(-3.0, 0.0, 3.0), width_px=256, height_px=240)
    return simulate("fracture", microscope, rng=0)


@pytest.fixture(scope="module")
def rows(simulated: Simulated) -> tuple[DetectorFigures, ...]:
    series, truth = simulated
    return compare_features(series, truth=truth)


def test_all_four_find_the_geometry(rows: tuple[DetectorFigures, ...]) -> None:
    assert [row.detector for row in rows] == list(DETECTORS)
    for row in rows:
        assert row.failed == 0
        assert row.keypoints > row.putative > row.inliers > 50
        assert row.precision is not None
        assert row.putative_precision is not None
        assert row.precision > 0.95
        assert row.precision >= row.putative_precision - 0.02
        assert row.error_px is not None
        assert 0.1 < row.error_px < 1.0
        assert row.residual_px is not None
        assert row.residual_px < row.error_px  # only the part across the line
        assert row.detect_s > 0


def test_without_truth_there_is_no_precision(simulated: Simulated) -> None:
    row = compare_features(simulated[0], detectors=["brief"])[0]
    assert (row.precision, row.putative_precision, row.error_px) == (None, None, None)
    assert row.inliers > 50


def test_views_of_other_specimens_fail_without_an_error(simulated: Simulated) -> None:
    series, _ = simulated
    noise = np.random.default_rng(0).uniform(0, 255, series.shape).astype(np.float32)
    blank = np.full(series.shape, 7.0, np.float32)
    views = tuple(replace(series.views[0], image=image) for image in (series.views[0].image, noise, blank))
    row = compare_features(replace(series, views=views), detectors=["sift"])[0]
    assert (row.inliers, row.failed, row.residual_px) == (0, 2, None)


def test_the_essential_matrix_gets_its_calibrations_or_says_what_it_lacks(simulated: Simulated) -> None:
    options = Options().with_settings(["robust.model=essential"])
    series, _ = simulated
    assert compare_features(series, options, detectors=["orb"])[0].failed == 0
    views = tuple(replace(view, metadata=replace(view.metadata, working_distance_um=np.nan)) for view in series.views)
    with pytest.raises(BadInputError, match="working distance"):
        compare_features(replace(series, views=views), options, detectors=["orb"])


def test_truth_of_other_views_is_refused(simulated: Simulated, tmp_path: Path) -> None:
    series, truth = simulated
    with pytest.raises(ValueError, match="truth is of 3 views, the series has 2"):
        compare_features(replace(series, views=series.views[:2]), truth=truth)
    folder = write_simulated_series(tmp_path / "series", series, truth)
    (folder / series.names[0]).unlink()
    with pytest.raises(BadInputError, match=r"truth\.json is of 3 views, the folder holds 2"):
        compare_features_of(folder)


def test_the_true_match_is_the_projection_of_the_surface_point(simulated: Simulated) -> None:
    """Nodes of the true surface, projected into both views by the true cameras: the closed form."""
    _, truth = simulated
    one, two = cameras_of(truth.motion)[:2]
    row, col = (index[::37] for index in np.nonzero(truth.visible[0] & truth.visible[1]))
    nodes = np.column_stack([col, row, truth.height_um[row, col], np.ones(len(col))]) @ truth.world_from_grid[:3].T
    found = true_match_px(truth, (0, 1), one.project(nodes))
    error = np.linalg.norm(found - two.project(nodes), axis=1)
    assert np.isfinite(error).mean() > 0.97
    assert np.nanpercentile(error, 95) < 0.05


def test_what_a_view_does_not_show_has_no_true_match(simulated: Simulated) -> None:
    _, truth = simulated
    outside = np.array([[-20.0, 100.0], [100.0, 900.0]])
    assert np.isnan(true_match_px(truth, (0, 1), outside)).all()
    assert true_match_px(truth, (0, 1), np.empty((0, 2))).shape == (0, 2)


def test_the_forms_hold_the_same_numbers(rows: tuple[DetectorFigures, ...]) -> None:
    table = features_table(rows, "series", "Detectors")
    told = json.loads(features_json(rows, Options()))
    lines = list(csv.DictReader(io.StringIO(features_csv(rows))))
    text = features_text(rows).splitlines()
    assert told["options"]["features"]["ratio"] == 0.8
    assert told["tolerance_px"] == 3
    for row, cells, values, line, printed in zip(rows, table.rows, told["detectors"], lines, text[1:5], strict=True):
        assert cells[0] == values["detector"] == line["detector"] == printed.split()[0] == row.detector
        assert cells[4] == values["inliers"] == float(line["inliers"]) == row.inliers
        assert cells[5] == pytest.approx(100 * values["precision"])
        assert float(printed.split()[5]) == pytest.approx(cells[5], abs=0.051)
    assert len({len(line) for line in text[:5]}) == 1


def test_the_command(simulated: Simulated, tmp_path: Path) -> None:
    folder = write_simulated_series(tmp_path / "series", *simulated)
    settings = ["--set", "features.max_keypoints=500", "--set", "features.spread=true"]
    done = CliRunner().invoke(app, ["compare-features", str(folder), "-o", str(tmp_path / "f.csv"), *settings])
    assert done.exit_code == 0, done.output
    assert "right inliers (%)" in done.stdout
    written = list(csv.DictReader(io.StringIO((tmp_path / "f.csv").read_text(encoding="utf-8"))))
    assert [row["detector"] for row in written] == ["sift", "surf", "orb", "brief"]
    assert max(float(row["keypoints"]) for row in written) == 500


def test_the_command_refuses_another_file_at_once(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["compare-features", str(tmp_path), "-o", "table.xlsx"])
    assert done.exit_code == 2
    assert ".csv or .json" in done.output


def test_the_experiment_makes_its_table_and_figure() -> None:
    found = features.run(Setting(quick=True))
    assert len(found.tables) == 1
    assert found.figures[0].png.startswith(b"\x89PNG")
    assert any("potamogeton1 is left out" in note for note in found.notes)
