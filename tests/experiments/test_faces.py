"""The experiment on faces: heads from meshes, and a quick run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from semscape.experiments.face_meshes import find_faces, head_specimen
from semscape.experiments.faces import METHODS, run
from semscape.experiments.study import Setting
from semscape.simulate import PRESETS, simulate
from semscape.types import FloatArray, SurfaceMesh


def mesh_of(shape: trimesh.Trimesh) -> SurfaceMesh:
    vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
    return SurfaceMesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8), "um")


def true_height_px(shape: trimesh.Trimesh, size: int) -> FloatArray:
    """Return the truth of an untilted view, in pixels, for a field of `size` px of 0.2 um."""
    options = replace(
        PRESETS["ideal"], tilts_deg=(0.0, 5.0), width_px=size, height_px=size, pixel_size_um=0.2, samples=1
    )
    _, truth = simulate(head_specimen("head", mesh_of(shape), 0.2 * size), options, rng=0)
    return truth.height_um / 0.2


def test_the_front_of_a_sphere_is_its_upper_side_in_a_ground() -> None:
    size = 101
    height = true_height_px(trimesh.creation.icosphere(subdivisions=5, radius=3.0), size)
    radius = 0.85 * size / 2
    at = np.arange(size) - (size - 1) / 2
    ball = np.sqrt(np.clip(radius**2 - at**2 - at[:, None] ** 2, 0, None))
    expected = np.maximum(ball, radius - 0.3 * size)
    off = height - (expected - radius + 0.15 * size)
    inside = np.abs(ball - (radius - 0.3 * size)) > 3  # beyond the crease, where the grid's nodes decide
    assert np.abs(off[inside]).max() < 0.05  # the facets' depth


def test_the_nearest_of_several_layers_counts_and_up_is_up() -> None:
    """A plate with a post behind it and a block on its upper half, y up."""
    plate = trimesh.creation.box((4.0, 4.0, 1.0))
    block = trimesh.creation.box((4.0, 2.0, 0.5), trimesh.transformations.translation_matrix((0, 1.0, 0.75)))
    post = trimesh.creation.box((1.0, 1.0, 1.0), trimesh.transformations.translation_matrix((0, 0, -1.0)))
    height = true_height_px(trimesh.util.concatenate([plate, block, post]), 100)
    assert height[30, 50] - height[70, 50] == pytest.approx(0.5 * 0.85 * 100 / 4, rel=1e-4)


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
