"""What no view has seen is closed about where a flat lid would lie, and every mesh is closed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from semscape.dense.closing import closing_points
from semscape.dense.oriented_points import OrientedPoints
from semscape.dense.poisson import closed_surface

SIZE = np.array([40.0, 30.0, 30.0])


def open_box(noise: float) -> OrientedPoints:
    """Return points on the lid and the four walls of a box whose bottom is missing."""
    rng = np.random.default_rng(0)
    points, normals = [], []
    for axis, ends in ((0, (0, 1)), (1, (0, 1)), (2, (1,))):
        others = [k for k in range(3) if k != axis]
        grid = np.stack(np.meshgrid(*(np.arange(0.25, SIZE[k], 0.5) for k in others)), axis=-1).reshape(-1, 2)
        for end in ends:
            place, normal = np.zeros((len(grid), 3)), np.zeros((len(grid), 3))
            place[:, others], place[:, axis], normal[:, axis] = grid, end * SIZE[axis], 2 * end - 1
            points.append(place + noise * rng.standard_normal((len(grid), 1)) * normal)
            normals.append(normal)
    found = np.concatenate(points)
    return OrientedPoints(found, np.concatenate(normals), np.full(len(found), 0.25))


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_an_open_box_is_closed_near_its_rim(noise: float) -> None:
    box = open_box(noise)
    lid = closing_points(box, 0.7)
    vertices, faces = closed_surface(box.with_others(lid), 0.7)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert 1.0 < mesh.volume / SIZE.prod() < 1.1
    assert vertices[:, 2].min() > -4  # nodes of the coarse grid, which are 1 apart
    bulging = trimesh.Trimesh(*closed_surface(box, 0.7), process=False)
    assert bulging.volume > mesh.volume
    down = lid.normals[:, 2] < -0.8
    assert np.average(down, weights=lid.area) > 0.9


def test_a_closed_surface_needs_no_closing() -> None:
    direction = np.random.default_rng(1).normal(size=(20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ball = OrientedPoints(10 * direction, direction, np.full(20_000, 4 * np.pi * 100 / 20_000))
    assert len(closing_points(ball, 0.5).points) == 0


def test_normals_that_point_inwards_still_give_a_closed_mesh() -> None:
    direction = np.random.default_rng(2).normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inside_out = OrientedPoints(5 * direction, -direction, np.full(4000, 4 * np.pi * 25 / 4000))
    assert trimesh.Trimesh(*closed_surface(inside_out, 0.5), process=False).is_watertight
