"""A solid body of a height map on a base plate, closed on all sides, for a 3D printer."""

from __future__ import annotations

import numpy as np

from semscape.dense.mesh import grid_stride
from semscape.errors import NoAnswerError
from semscape.types import HeightMap, SurfaceMesh


def plate_side(height_map: HeightMap, max_vertices: int) -> float:
    """Return the longest side of the body's plate in the map's unit: from the first to the last row or column taken."""
    stride = grid_stride(height_map, max_vertices)
    steps = (max(height_map.height_um.shape) - 1) // stride
    return float(steps * stride * height_map.pixel_size_um)


def print_body(height_map: HeightMap, *, base: float, max_vertices: int) -> SurfaceMesh:
    """Return a watertight body: the surface above, a flat plate below, and four walls.

    Unknown heights are not made up: there the body goes down to the plate, at the level of the least height.

    Parameters
    ----------
    height_map : HeightMap
        Heights; every n-th row and column is taken such that at most `max_vertices` remain.
    base : float
        Thickness of the plate in the map's unit.
    max_vertices : int
        Largest number of vertices of the upper side.

    Raises
    ------
    NoAnswerError
        If no height is known, or the grid has less than two rows or columns.
    """
    stride = grid_stride(height_map, max_vertices)
    height = height_map.height_um[::stride, ::stride]
    if not np.isfinite(height).any() or min(height.shape) < 2:
        raise NoAnswerError("no body can be printed: the height map holds no heights, or less than two rows or columns")
    rows, columns = height.shape
    least = np.nanmin(height)
    row, col = (axis * stride for axis in np.indices(height.shape))
    grid = np.stack([col, row, np.where(np.isfinite(height), height, least), np.ones_like(height)], axis=-1)
    top = (grid @ height_map.world_from_grid.T)[..., :3].reshape(-1, 3)

    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    upper = [np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([b, c, d], axis=-1).reshape(-1, 3)]

    # Around the edge, counter-clockwise seen from above: down the left side, for the first row has the largest y.
    edge = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    floor = top[edge].copy()
    floor[:, 2] = least - base
    centre = floor.mean(axis=0, keepdims=True)
    below = len(top) + np.arange(len(edge))
    next_edge, next_below = np.roll(edge, -1), np.roll(below, -1)
    walls = [np.stack([edge, below, next_below], axis=1), np.stack([edge, next_below, next_edge], axis=1)]
    underside = np.stack([next_below, below, np.full(len(edge), len(top) + len(edge))], axis=1)

    vertices = np.concatenate([top, floor, centre])
    faces = np.concatenate([*upper, *walls, underside])
    return SurfaceMesh(vertices, faces, np.full((len(vertices), 3), 200, np.uint8), height_map.length_unit)
