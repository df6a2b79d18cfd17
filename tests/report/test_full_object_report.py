"""The run folder of a full object: a ball from six sides."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from semscape.dense.full_object import FullObject
from semscape.dense.groups import PlacedMap
from semscape.dense.merge import merge_maps
from semscape.geometry.rotations import axis_rotation
from semscape.io.run_folder import prepare_run_folder
from semscape.io.surfaces import read_height_map
from semscape.options import MeshOptions, Options
from semscape.report.full_object import object_verdict, write_full_object
from semscape.sfm.adjust import Adjustment
from semscape.sfm.full_object import PARAMETERS_PER_VIEW, FullObjectMotion
from semscape.types import HeightMap, Micrograph, Observations, StageReport, TiltSeries

SIDE, PIXEL, RADIUS = 50, 0.2, 4.0


def half_ball(axis_rad: float, turn_rad: float) -> PlacedMap:
    row, col = np.indices((SIDE, SIDE))
    x, y = (col - (SIDE - 1) / 2) * PIXEL, -(row - (SIDE - 1) / 2) * PIXEL
    squared = RADIUS**2 - x**2 - y**2
    height = np.where(squared > 0, np.sqrt(np.maximum(squared, 0)), np.nan)
    grid = np.diag([PIXEL, -PIXEL, 1.0, 1.0])
    grid[:2, 3] = -PIXEL * (SIDE - 1) / 2, PIXEL * (SIDE - 1) / 2
    seen = np.isfinite(height).astype(np.uint8)
    found = HeightMap(height, 0 * height, 2 * seen, (100 + col).astype(np.float32), PIXEL, grid, "um")
    pose = np.eye(4)
    pose[:3, :3] = axis_rotation(axis_rad, turn_rad)
    return PlacedMap((0, 1), found, pose)


@pytest.fixture(scope="module")
def ball() -> FullObject:
    blank = np.zeros((SIDE, SIDE), np.float32)
    series = TiltSeries(tuple(Micrograph(f"<{k}>.tif", blank, blank == 0) for k in range(4)))
    four, nothing = np.zeros(4), np.empty(0)
    parameters = np.zeros(1 + 4 * PARAMETERS_PER_VIEW)
    adjustment = Adjustment(parameters, np.eye(len(parameters)), nothing, nothing, nothing, 0.3, 1.0, 1)
    tracks = Observations(nothing.astype(int), nothing.astype(int), np.empty((0, 2)))
    motion = FullObjectMotion(np.tile(np.eye(3), (4, 1, 1)), 0.0, four, four, four + 5, tracks, adjustment)
    quarter = np.pi / 2
    sides = [(0.0, k * quarter) for k in range(4)] + [(quarter, quarter), (quarter, -quarter)]
    maps = tuple(half_ball(*side) for side in sides)
    return FullObject(series, motion, maps, merge_maps(maps))


def test_the_folder_holds_a_watertight_mesh_and_says_where_each_map_lies(ball: FullObject, tmp_path: Path) -> None:
    folder = write_full_object(ball, Options(), [StageReport("surface", 1.0)], ["a pair"], tmp_path / "run")
    for name in ("merged.ply", "merged.glb"):
        mesh = trimesh.load(folder / name, force="mesh", process=False)
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.03)
    report = json.loads((folder / "report.json").read_text())
    assert report["metrics"]["n_groups"] == 6
    assert report["metrics"]["volume"] == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.03)
    assert report["failures"] == ["a pair"]
    assert report["contradictions"] == []
    assert report["verdict"].startswith("do not measure: the tracks leave open")  # nobody told the ball a sense
    for group, placed in zip(report["groups"], ball.maps, strict=True):
        height_map = read_height_map(folder / group["file"])
        np.testing.assert_allclose(height_map.height_um, placed.height_map.height_um, rtol=1e-6)
        row, col = np.nonzero(np.isfinite(height_map.height_um))
        grid = np.column_stack([col, row, height_map.height_um[row, col], np.ones(len(row))])
        world = grid @ np.array(group["world_from_grid"]).T
        np.testing.assert_allclose(np.linalg.norm(world[:, :3], axis=1), RADIUS, rtol=1e-6)
    assert len(json.loads((folder / "reconstruction.json").read_text())["views"]) == 4
    html = (folder / "report.html").read_text()
    assert "&lt;0&gt;.tif" in html
    assert "<0>" not in html
    assert "http:" not in html
    prepare_run_folder(folder)  # the same command may write there again


def test_the_verdict_is_that_of_the_least_known_group(ball: FullObject) -> None:
    """Two views 10 deg apart, each tilt known to 0.1 deg: heights to 1.96 * 0.1 * root 2 / 10, 2.8 %."""
    tilt = np.deg2rad([0.0, 10.0, 20.0, 30.0])

    def known_to(sigma_deg: float, **other: Any) -> str:
        adjustment = replace(
            ball.motion.adjustment, covariance=np.deg2rad(sigma_deg) ** 2 * np.eye(1 + 4 * PARAMETERS_PER_VIEW)
        )
        motion = replace(ball.motion, tilt_rad=tilt, adjustment=adjustment, sense_margin=100.0, **other)
        return object_verdict(replace(ball, motion=motion))

    assert known_to(0.1).startswith("good: heights of the least known group of views to +-2.8% (95 %)")
    assert known_to(0.5).startswith("usable: ")
    assert known_to(1.0).startswith("do not measure: ")
    assert known_to(0.1, contradictions=("2.tif: mistyped",)).endswith(
        "contradict what was told of them. 2.tif: mistyped"
    )


def test_a_decimated_mesh_tells_its_distance(ball: FullObject, tmp_path: Path) -> None:
    options = Options(mesh=MeshOptions(triangles=2000))
    folder = write_full_object(ball, options, [], [], tmp_path / "run")
    mesh = trimesh.load(folder / "merged.ply", process=False)
    assert len(mesh.faces) <= 2000
    assert mesh.is_watertight
    decimation = json.loads((folder / "report.json").read_text())["decimation"]
    assert 0 < decimation["rms"] < decimation["largest"] < 0.3 * PIXEL
