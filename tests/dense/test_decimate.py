"""Fewer triangles: as few as asked for, as near as told, with the micrograph still in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.dense.decimate import decimate, finished_mesh
from semscape.dense.mesh import height_map_mesh
from semscape.errors import BadInputError, NoAnswerError
from semscape.options import MeshOptions
from semscape.types import HeightMap

SIDE = 90


def wavy() -> HeightMap:
    row, col = np.indices((SIDE, SIDE))
    height = 4 * np.sin(row / 9) * np.cos(col / 11)
    height[40:50, 30:36] = np.nan
    grid = np.diag([0.5, -0.5, 1.0, 1.0])
    seen = np.full(height.shape, 3, np.uint8)
    return HeightMap(height, np.ones_like(height), seen, (col + 100.0 * row).astype(np.float32), 0.5, grid, "um")


def brute_force_um(height_map: HeightMap, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the largest vertical distance of the map's pixels to the triangles above or below them."""
    full = height_map_mesh(height_map, max_vertices=10**6).vertices_um
    worst = 0.0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    for point in full[::7]:
        u, v, w = b[:, :2] - a[:, :2], c[:, :2] - a[:, :2], point[:2] - a[:, :2]
        det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / det
        t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / det
        inside = np.flatnonzero((s > -1e-6) & (t > -1e-6) & (s + t < 1 + 1e-6))
        if len(inside):
            k = inside[0]
            worst = max(worst, abs(a[k, 2] + s[k] * (b - a)[k, 2] + t[k] * (c - a)[k, 2] - point[2]))
    return worst


def test_the_number_of_triangles_is_reached_and_the_error_is_what_is_stated() -> None:
    height_map = wavy()
    full = height_map_mesh(height_map, max_vertices=10**6)
    mesh, distance = decimate(full, MeshOptions(triangles=3000))
    assert 2900 <= len(mesh.faces) <= 3000
    assert 0 < distance.rms < distance.largest < 0.3
    # Distances are never longer than the vertical way, nor shorter than that times the cosine of the steepest slope.
    vertical = brute_force_um(height_map, mesh.vertices_um, mesh.faces)
    assert 0.4 * vertical < distance.largest
    area = np.linalg.norm(np.cross(*(mesh.vertices_um[mesh.faces[:, k]] - mesh.vertices_um[mesh.faces[:, 0]]
                                     for k in (1, 2))), axis=1).sum() / 2  # fmt: skip
    of_full = np.linalg.norm(np.cross(*(full.vertices_um[full.faces[:, k]] - full.vertices_um[full.faces[:, 0]]
                                        for k in (1, 2))), axis=1).sum() / 2  # fmt: skip
    assert area == pytest.approx(of_full, rel=0.01)  # the gap is neither closed nor widened


def test_an_error_to_stay_within_gives_the_fewest_triangles() -> None:
    full = height_map_mesh(wavy(), max_vertices=10**6)
    coarse, loose = decimate(full, MeshOptions(error_um=0.2))
    fine, tight = decimate(full, MeshOptions(error_um=0.02))
    assert loose.largest <= 0.2
    assert tight.largest <= 0.02
    assert len(coarse.faces) < 0.6 * len(fine.faces) < len(full.faces)
    _, too_far = decimate(full, MeshOptions(triangles=int(0.8 * len(coarse.faces))))
    assert too_far.largest > 0.2


def test_the_micrograph_lies_where_it_was_seen() -> None:
    height_map = wavy()
    mesh, figures = finished_mesh(height_map, 10**6, MeshOptions(triangles=1500))
    assert figures["n_faces"] == len(mesh.faces) <= 1500 < figures["n_faces_full"]
    assert mesh.uv is not None
    assert mesh.picture is not None
    assert mesh.picture.shape == (SIDE, SIDE)
    col, row = mesh.vertices_um[:, 0] / 0.5, -mesh.vertices_um[:, 1] / 0.5
    assert np.allclose(mesh.uv[:, 0] * SIDE - 0.5, col)
    assert np.allclose((1 - mesh.uv[:, 1]) * SIDE - 0.5, row)
    small, _ = finished_mesh(height_map, 10**6, MeshOptions(texture_px=30))
    assert small.picture is not None
    assert small.picture.shape == (30, 30)


def test_a_mesh_without_triangles_says_whether_the_heights_or_the_thinning_lack_them() -> None:
    height_map = wavy()
    border = height_map.height_um.copy()
    border[[0, -1]] = border[:, [0, -1]] = np.nan  # as at the border of any field
    with pytest.raises(BadInputError, match=r"mesh_max_vertices = 4 leaves no triangle of 7,684 known heights"):
        finished_mesh(replace(height_map, height_um=border), 4, MeshOptions())
    single = np.full_like(border, np.nan)
    single[20, 20] = single[60, 60] = 0.0
    with pytest.raises(NoAnswerError, match=r"no part of the field \(2 single pixels are known\)"):
        finished_mesh(replace(height_map, height_um=single), 10**6, MeshOptions())
