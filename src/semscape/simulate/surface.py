"""Surfaces that beams meet: height fields and triangle meshes, each with what the signal needs of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from semscape.simulate.bvh import build_hierarchy, first_hits
from semscape.simulate.cast import block_tops, cast_rays, sample_bilinear
from semscape.simulate.mesh import MeshSpecimen, hemisphere, refine, smooth_between_creases
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.signal import surface_layers
from semscape.simulate.specimens import Specimen
from semscape.types import FloatArray, IntArray

NORMAL, THINNESS, SKY = slice(0, 3), 3, 4
SKY_REACH_PX = 64.0
_DIRECTIONS = 24
_EDGE_PX = 4.0


class Surface(Protocol):
    """What the renderer asks of a specimen."""

    def cast(self, points_um: FloatArray, directions: FloatArray) -> tuple[FloatArray, NDArray[Any]]:
        """Return where beams first meet the surface.

        Parameters
        ----------
        points_um : (N, 3) float array
            A point on each beam.
        directions : (N, 3) or (1, 3) float array
            Unit vectors along the beams, away from the source.

        Returns
        -------
        position_um : (N, 3) float array
            The first hit, NaN where there is none.
        place : (N, ...) array
            The same place in the surface's own terms, for `attributes`.
        """
        ...

    def attributes(self, place: NDArray[Any]) -> FloatArray:
        """Return (N, 5) at places of `cast`: unit normal, thinness of edges and open sky, both in [0, 1]."""
        ...

    def normals(self, place: NDArray[Any]) -> FloatArray:
        """Return the unit normals (N, 3) at places of `cast`."""
        ...


class ReliefSurface:
    """A height field; between its nodes it is bilinear."""

    def __init__(self, specimen: Specimen, options: SimulationOptions) -> None:
        self._height = specimen.height_um
        self._tops = block_tops(specimen.height_um)
        self._scale = np.diag(specimen.grid_from_world[:, :2]).copy()
        self._offset = specimen.grid_from_world[:, 2].copy()
        self._bounds = float(np.nanmin(specimen.height_um)), float(np.nanmax(specimen.height_um))
        self._layers = surface_layers(specimen.height_um, specimen.pitch_um, SKY_REACH_PX, options)

    def cast(self, points_um: FloatArray, directions: FloatArray) -> tuple[FloatArray, NDArray[Any]]:
        """See `Surface`; the beams come from above."""
        per_um = directions[:, :2] / directions[:, 2:]
        origin = np.empty((len(points_um), 2))
        for k in range(2):  # faster than the broadcast over short rows
            origin[:, k] = (points_um[:, k] - points_um[:, 2] * per_um[:, k]) * self._scale[k] + self._offset[k]
        position = np.empty((len(points_um), 3))
        bottom, top = self._bounds
        cast_rays(self._height, self._tops, origin, per_um * self._scale, top, bottom, position)
        place = position[:, :2].copy()
        for k in range(2):
            position[:, k] = (position[:, k] - self._offset[k]) / self._scale[k]
        return position, place

    def attributes(self, place: NDArray[Any]) -> FloatArray:
        """See `Surface`."""
        out = np.empty((len(place), 5))
        sample_bilinear(self._layers, place, out)
        out[:, NORMAL] /= np.sqrt(out[:, 0] ** 2 + out[:, 1] ** 2 + out[:, 2] ** 2)[:, None]
        return out

    def normals(self, place: NDArray[Any]) -> FloatArray:
        """See `Surface`."""
        return self.attributes(place)[:, NORMAL]


class MeshSurface:
    """Triangles, with overhangs; normals are smooth but across creases."""

    def __init__(self, specimen: MeshSpecimen, options: SimulationOptions) -> None:
        pixel = options.pixel_size_um
        smooth = smooth_between_creases(specimen.vertices_um, specimen.faces)
        vertices, normals, self._faces = refine(*smooth, _EDGE_PX * pixel)
        self._tree = build_hierarchy(vertices, self._faces)
        self._reach = 2.0 * float(np.linalg.norm(np.ptp(vertices, axis=0))) + 2.0 * float(np.abs(vertices).max())
        self._corner_normals = normals[self._faces]
        self._by_vertex = np.empty((len(vertices), 5))
        self._by_vertex[:, NORMAL] = normals
        self._within = _into_faces(vertices, self._faces)
        self._escape = max(options.edge_px, 1e-3) * pixel
        self._sky_reach = SKY_REACH_PX * pixel
        self._known = np.zeros(len(vertices), dtype=np.bool_)

    def _learn(self, corners: IntArray) -> None:
        """Find thinness and open sky of vertices at which no beam has landed before: most of a mesh nobody ever sees.

        Two threads that come to the same vertex at once write the same numbers.
        """
        asked = np.zeros(len(self._known), dtype=np.bool_)
        asked[corners[~self._known[corners]]] = True
        new = np.flatnonzero(asked)
        at, normal = self._within[new], self._by_vertex[new, NORMAL]
        self._by_vertex[new, THINNESS] = self._thinness(at, normal, self._escape)
        self._by_vertex[new, SKY] = self._open_sky(at, normal, self._sky_reach)
        self._known[new] = True

    def _open_sky(self, points: FloatArray, normals: FloatArray, reach: float) -> FloatArray:
        """Return the share of the sky above, weighted by the cosine to the vertical, that nothing hides."""
        start = points + 1e-4 * reach * normals
        total = np.zeros(len(points))
        for direction in hemisphere(_DIRECTIONS):
            # A product of matrices may round otherwise for another number of points, and so on another thread.
            above = (normals * direction).sum(axis=1) > 0
            distance, _, _ = first_hits(self._tree, start[above], direction[None, :], 0.0, reach)
            total[above] += np.isinf(distance)
        return total / _DIRECTIONS

    def _thinness(self, points: FloatArray, normals: FloatArray, escape: float) -> FloatArray:
        """Return the mean over directions into the material of how much nearer than the escape depth it ends."""
        helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        u = np.cross(normals, helper)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        v = np.cross(normals, u)
        start = points - 1e-3 * escape * normals
        total = np.zeros(len(points))
        for a, b, c in hemisphere(_DIRECTIONS):
            inward = a * u + b * v - c * normals
            distance, _, _ = first_hits(self._tree, start, inward, 0.0, escape)
            total += 1.0 - np.minimum(distance / escape, 1.0)
        share: FloatArray = total / _DIRECTIONS
        return share

    def cast(self, points_um: FloatArray, directions: FloatArray) -> tuple[FloatArray, NDArray[Any]]:
        """See `Surface`."""
        distance, face, weights = first_hits(self._tree, points_um, directions, -self._reach, self._reach)
        position = points_um + np.where(np.isinf(distance), np.nan, distance)[:, None] * directions
        # A face seen from behind: its normals belong to the other side.
        facing = np.einsum(
            "nk,nk->n", self._corner_normals[face].sum(axis=1), np.broadcast_to(directions, position.shape)
        )
        return position, np.column_stack([face, weights, np.where(facing > 0, -1.0, 1.0)])

    def attributes(self, place: NDArray[Any]) -> FloatArray:
        """See `Surface`."""
        self._learn(self._faces[place[:, 0].astype(np.int64)])
        return self._between_corners(self._by_vertex, place)

    def normals(self, place: NDArray[Any]) -> FloatArray:
        """See `Surface`."""
        return self._between_corners(self._by_vertex[:, NORMAL], place)

    def _between_corners(self, by_vertex: FloatArray, place: NDArray[Any]) -> FloatArray:
        """Interpolate over the triangles of `place` what is known of vertices (P, K); the first three are a normal."""
        corners: IntArray = self._faces[place[:, 0].astype(np.int64)]
        v, w = place[:, 1:2], place[:, 2:3]
        out: FloatArray = (1.0 - v - w) * by_vertex[corners[:, 0]]
        out += v * by_vertex[corners[:, 1]]
        out += w * by_vertex[corners[:, 2]]
        out[:, NORMAL] *= place[:, 3:] / np.linalg.norm(out[:, NORMAL], axis=1, keepdims=True)
        return out


def _into_faces(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Move vertices (P, 3) a hundredth of the way into their faces: on a crease they lie on other faces as well."""
    count = np.maximum(np.bincount(faces.ravel(), minlength=len(vertices)), 1)
    centre = np.repeat(vertices[faces].mean(axis=1), 3, axis=0)
    mean = np.stack([np.bincount(faces.ravel(), centre[:, k], len(vertices)) for k in range(3)], axis=1)
    moved: FloatArray = vertices + 0.01 * (mean / count[:, None] - vertices)
    return moved


def in_blocks(count: int, size: int, work: Callable[[int, int], None], workers: int) -> None:
    """Call work(start, stop) for all blocks of `size` items, on `workers` threads."""
    blocks = [(start, min(start + size, count)) for start in range(0, count, size)]
    if workers <= 1:
        for start, stop in blocks:
            work(start, stop)
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda block: work(*block), blocks))
