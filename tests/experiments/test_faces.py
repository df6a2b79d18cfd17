"""The experiment on faces: heads from meshes, and a quick run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from semscape.experiments.face_meshes import find_faces, head_specimen
from semscape.experiments.faces import METHODS, run
from semscape.experiments.study import Setting
from semscape.types import SurfaceMesh


def mesh_of(shape: trimesh.Trimesh) -> SurfaceMesh:
    vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
    return SurfaceMesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8), "um")


def test_the_front_of_a_sphere_is_its_upper_side_on_a_ground() -> None:
    mesh = mesh_of(trimesh.creation.icosphere(subdivisions=5, radius=3.0))
    field, pitch = 20.0, 0.1
    specimen = head_specimen("ball", mesh, field, pitch)
    radius = 0.85 * field / 2
    rows, cols = specimen.height_um.shape
    to_grid = specimen.grid_from_world
    y, x = (
        ((np.arange(rows) - to_grid[1, 2]) / to_grid[1, 1])[:, None],
        (np.arange(cols) - to_grid[0, 2]) / to_grid[0, 0],
    )
    ball = np.sqrt(np.clip(radius**2 - x**2 - y**2, 0, None))
    expected = np.maximum(ball, radius - 0.3 * field)
    off = specimen.height_um - (expected - (expected.min() + expected.max()) / 2)
    assert np.abs(off).max() < 0.01  # the facets' depth
    assert min(rows, cols) * pitch > 1.7 * field


def test_the_nearest_of_several_layers_counts_and_up_is_up() -> None:
    """A plate with a post behind it and a block on its upper half, y up."""
    plate = trimesh.creation.box((4.0, 4.0, 1.0))
    block = trimesh.creation.box((4.0, 2.0, 0.5), trimesh.transformations.translation_matrix((0, 1.0, 0.75)))
    post = trimesh.creation.box((1.0, 1.0, 1.0), trimesh.transformations.translation_matrix((0, 0, -1.0)))
    specimen = head_specimen("steps", mesh_of(trimesh.util.concatenate([plate, block, post])), 10.0, 0.1)
    middle = specimen.height_um.shape[0] // 2
    scale = 0.85 * 10 / 4
    upper, lower = specimen.height_um[middle - 20, middle], specimen.height_um[middle + 20, middle]
    assert upper - lower == pytest.approx(0.5 * scale, rel=1e-4)


def test_without_data_there_is_the_built_in_face_alone(tmp_path: Path) -> None:
    assert find_faces(None) == find_faces(tmp_path) == {"face": None}


@pytest.mark.real_data
def test_the_scanned_heads_are_found(shared_data: Path) -> None:
    assert {"face", "menpo_james"} <= set(find_faces(shared_data))


def test_a_quick_run_has_every_case_with_every_method() -> None:
    done = run(Setting(quick=True))
    cases = next(table for table in done.tables if table.name == "cases")
    assert [row[:4] for row in cases.rows] == [("face", views, 6.0, method) for views in (2, 3) for method in METHODS]
    # The thesis's route may fail, and may be wrong by any angle: that is what its column shows.
    ours = [row for row in cases.rows if row[3] != "thesis"]
    value = {name: [row[i] for row in ours] for i, name in enumerate(cases.columns)}
    assert all(0.001 < error < 0.6 for error in value["rotation error (deg)"])
    assert all(0.2 < error < 6 for error in value["median height error (px)"])
    assert all(0.05 < share < 0.9 for share in value["completeness at 1 px"])
    assert done.figures[0].png.startswith(b"\x89PNG")
    assert "left out" in done.notes[-1]
