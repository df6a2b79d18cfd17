"""The mesh over a height map: cut at jumps, outside up, as fine as allowed."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.dense.mesh import grey_levels, height_map_mesh
from semscape.types import HeightMap

PIXEL = 0.5


def height_map(height: np.ndarray) -> HeightMap:
    rows, columns = height.shape
    world_from_grid = np.diag([PIXEL, -PIXEL, 1.0, 1.0])
    world_from_grid[:2, 3] = -PIXEL * (columns - 1) / 2, PIXEL * (rows - 1) / 2
    texture = np.tile(np.linspace(0, 1000, columns, dtype=np.float32), (rows, 1))
    known = np.isfinite(height)
    return HeightMap(
        height.astype(float),
        np.where(known, 0.1, np.nan),
        known.astype(np.uint8),
        texture,
        PIXEL,
        world_from_grid,
        "um",
    )


def normals(mesh) -> np.ndarray:
    a, b, c = (mesh.vertices_um[mesh.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def test_a_full_map_gives_two_triangles_a_cell_all_facing_up() -> None:
    rows, cols = np.indices((30, 40))
    mesh = height_map_mesh(height_map(2 * np.sin(rows / 5) + 0.1 * cols), max_vertices=10**6)
    assert len(mesh.vertices_um) == 30 * 40
    assert len(mesh.faces) == 2 * 29 * 39
    assert (normals(mesh)[:, 2] > 0).all()  # counter-clockwise from +z
    area = 0.5 * normals(mesh)[:, 2].sum()
    assert area == pytest.approx(29 * 39 * PIXEL**2)


def test_vertices_are_world_points_of_the_map() -> None:
    height = np.random.default_rng(0).uniform(0, 1, (12, 15))
    given = height_map(height)
    mesh = height_map_mesh(given, max_vertices=10**6)
    rows, cols = np.indices(height.shape)
    grid = np.column_stack([cols.ravel(), rows.ravel(), height.ravel(), np.ones(height.size)])
    np.testing.assert_allclose(mesh.vertices_um, (grid @ given.world_from_grid.T)[:, :3])
    assert mesh.length_unit == "um"


def test_jumps_are_cut() -> None:
    height = np.zeros((20, 20))
    height[:, 10:] = 50.0
    mesh = height_map_mesh(height_map(height), max_vertices=10**6)
    spread = np.ptp(mesh.vertices_um[mesh.faces][:, :, 2], axis=1)
    assert spread.max() == 0
    assert len(mesh.faces) == 2 * 19 * 18


def test_steep_slopes_are_kept() -> None:
    height = np.tile(PIXEL * 3.0 * np.arange(20), (10, 1))  # 72 deg
    assert len(height_map_mesh(height_map(height), max_vertices=10**6).faces) == 2 * 9 * 19


def test_holes_stay_holes_and_every_vertex_is_used() -> None:
    height = np.zeros((20, 20))
    height[5:9, 5:9] = np.nan
    mesh = height_map_mesh(height_map(height), max_vertices=10**6)
    assert np.isfinite(mesh.vertices_um).all()
    np.testing.assert_array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices_um)))
    centre = mesh.vertices_um[mesh.faces].mean(axis=1)[:, :2]
    hole = np.abs(centre - (PIXEL * (6.5 - 9.5), PIXEL * (9.5 - 6.5))).max(axis=1) < 2 * PIXEL
    assert not hole.any()


def test_an_unknown_map_gives_no_faces() -> None:
    mesh = height_map_mesh(height_map(np.full((9, 9), np.nan)), max_vertices=100)
    assert len(mesh.faces) == len(mesh.vertices_um) == 0


@pytest.mark.parametrize("most", [100, 500, 3000])
def test_no_more_vertices_than_allowed(most: int) -> None:
    mesh = height_map_mesh(height_map(np.zeros((100, 120))), max_vertices=most)
    assert 0.2 * most < len(mesh.vertices_um) <= most
    extent = np.ptp(mesh.vertices_um, axis=0)
    np.testing.assert_allclose(extent[:2], (119 * PIXEL, 99 * PIXEL), rtol=0.15)


def test_the_colour_is_the_micrograph() -> None:
    mesh = height_map_mesh(height_map(np.zeros((10, 200))), max_vertices=10**6)
    grey = mesh.color[:, 0].astype(float)
    assert (mesh.color == mesh.color[:, :1]).all()
    assert np.corrcoef(grey, mesh.vertices_um[:, 0])[0, 1] > 0.99
    assert (grey.min(), grey.max()) == (0, 255)


def test_grey_levels_of_nothing_are_black() -> None:
    assert (grey_levels(np.full((3, 3), np.nan, np.float32)) == 0).all()
    assert (grey_levels(np.full((3, 3), 7, np.float32)) == 0).all()
