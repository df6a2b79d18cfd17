"""Height maps from all around, merged into one watertight mesh.

Each map sees a part of the object, well where it looks at it squarely. A height counts if it does not float in front of
what other maps see: the fringe of false heights along an outline, which each map has, floats before the surface that
the others see from the side. What stays goes as oriented points into one Poisson reconstruction, which also closes what
no view has seen, like the foot of the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from semscape.dense.closing import closing_points
from semscape.dense.groups import PlacedMap
from semscape.dense.oriented_points import OrientedPoints
from semscape.dense.poisson import closed_surface
from semscape.dense.samples import map_samples
from semscape.errors import NoAnswerError
from semscape.types import BoolArray, FloatArray, IntArray, SurfaceMesh

_AGREEMENT_PX = 4.0
_MOST_CONFLICTS = 0.34
# What one map alone sees is believed where it looks at it squarely.
_SQUARE = np.cos(np.deg2rad(45.0))
# But not where so many others look at such a place, and none of them sees it.
_MISSED, _WOULD_SEE = 2, np.cos(np.deg2rad(60.0))
_MOST_NODES = 6_000_000
_FINEST_CELL_PX = 1.25
_LEAST_POINTS = 100
# A vertex farther than this from all that was seen is closed up, not measured.
_MEASURED_CELLS = 3.0
_CLOSED_UP = (165, 190, 220)


@dataclass(frozen=True, eq=False)
class MergedSurface:
    """A watertight mesh, which of its vertices (P,) views have seen, and the size of the grid's cells it came from.

    `measured` is the share of its area that views have seen; the rest, bluish, only closes the body.
    """

    mesh: SurfaceMesh
    seen: BoolArray
    measured: float
    cell_um: float


def merge_maps(maps: Sequence[PlacedMap]) -> MergedSurface:
    """Merge height maps that lie in one world into a watertight mesh.

    Parameters
    ----------
    maps : sequence of PlacedMap
        At least one, all in the same unit.

    Raises
    ------
    NoAnswerError
        If the maps have no heights that agree.
    """
    parts = []
    for index, placed in enumerate(maps):
        samples = map_samples(placed)
        others = [other for k, other in enumerate(maps) if k != index]
        support, conflict = _votes(samples.points, others)
        believed = conflict <= _MOST_CONFLICTS * (1 + support + conflict)
        believed &= (support > 0) | ((samples.squareness >= _SQUARE) & (_looking(samples.normals, others) < _MISSED))
        parts.append(samples.only(believed, 1.0 + support))
    points = np.concatenate([part.points for part in parts])
    if len(points) < _LEAST_POINTS:
        raise NoAnswerError(
            f"the {len(maps)} height maps agree on {len(points)} places only, too few for a body; check the tilts and "
            "the rotations of the stage"
        )
    normals = np.concatenate([part.normals for part in parts])
    area = np.concatenate([part.area for part in parts])
    size = np.prod(np.ptp(points, axis=0) * 1.3)
    cell = max(_FINEST_CELL_PX * maps[0].height_map.pixel_size_um, float(np.cbrt(size / _MOST_NODES)))
    known = OrientedPoints(points, normals, area)
    vertices, faces = _largest_part(*closed_surface(known.with_others(closing_points(known, cell)), cell))
    grey = np.concatenate([part.grey for part in parts])
    squareness = np.concatenate([part.squareness for part in parts])
    color, distance = _colors(vertices, points, grey, squareness)
    corners = vertices[faces]
    face_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    seen = distance <= _MEASURED_CELLS * cell
    measured = float(np.average(seen[faces].all(axis=1), weights=face_area))
    colors = np.where(seen[:, None], color[:, None], _CLOSED_UP).astype(np.uint8)
    return MergedSurface(SurfaceMesh(vertices, faces, colors, maps[0].height_map.length_unit), seen, measured, cell)


def _looking(normals: FloatArray, others: Sequence[PlacedMap]) -> FloatArray:
    """Return how many maps look at places with these normals (N, 3) within 60 deg."""
    up = np.array([placed.world_from_group[:3, 2] for placed in others]).reshape(-1, 3)
    return np.asarray((normals @ up.T >= _WOULD_SEE).sum(axis=1), np.float64)


def _votes(points: FloatArray, others: Sequence[PlacedMap]) -> tuple[FloatArray, FloatArray]:
    """Return how many maps see a surface at the points (N, 3), and how many see through them to one behind."""
    support, conflict = np.zeros(len(points)), np.zeros(len(points))
    world = np.column_stack([points, np.ones(len(points))])
    for placed in others:
        height_map = placed.height_map
        grid_from_world = np.linalg.inv(placed.world_from_grid)
        col, row, level, _ = grid_from_world @ world.T
        rows, columns = height_map.height_um.shape
        r, c = np.rint(row).astype(np.int64), np.rint(col).astype(np.int64)
        inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
        there = np.where(inside, height_map.height_um[np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)], np.nan)
        above = (level - there) / height_map.pixel_size_um
        with np.errstate(invalid="ignore"):
            support += np.abs(above) <= _AGREEMENT_PX
            conflict += above > _AGREEMENT_PX
    return support, conflict


def _largest_part(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the part of a mesh that hangs together and has the most triangles."""
    links = coo_array(
        (np.ones(2 * len(faces), np.int8), (np.tile(faces[:, 0], 2), faces[:, 1:].T.ravel())), (len(vertices),) * 2
    )
    _, part = connected_components(links, directed=False)
    kept = faces[part[faces[:, 0]] == np.bincount(part[faces[:, 0]]).argmax()]
    used, numbered = np.unique(kept, return_inverse=True)
    return vertices[used], numbered.reshape(-1, 3)


def _colors(
    vertices: FloatArray, points: FloatArray, grey: FloatArray, squareness: FloatArray
) -> tuple[np.ndarray[tuple[int], np.dtype[np.uint8]], FloatArray]:
    """Return the grey of the vertices (P,) as the map sees them that looks at them most squarely, and how far it is."""
    count = min(8, len(points))
    distance, near = cKDTree(points).query(vertices, k=count)
    distance, near = distance.reshape(len(vertices), -1), near.reshape(len(vertices), -1)
    close = distance <= 2 * distance[:, :1] + 1e-12
    best = np.argmax(np.where(close, squareness[near], -1.0), axis=1)
    chosen = np.take_along_axis(near, best[:, None], axis=1)[:, 0]
    return np.rint(grey[chosen]).astype(np.uint8), distance[:, 0]
