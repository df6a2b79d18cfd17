"""All figures of one result against the truth of its simulated series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from semscape.dense.mesh import height_map_mesh
from semscape.errors import BadInputError
from semscape.evaluate.align import ALIGNMENTS, AlignmentKind, align_points
from semscape.evaluate.distances import surface_figures
from semscape.evaluate.height_errors import HeightError, height_error, height_figures, true_units
from semscape.evaluate.motion_errors import tilt_figures
from semscape.evaluate.surface import Surface, make_surface
from semscape.evaluate.transmission import transmission_figures
from semscape.types import HeightMap, Motion, SimulationTruth, SurfaceMesh

_MESH_VERTICES = 150_000
_LEAST_VIEWS = 2


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The figures of a result as nested plain values, and its errors over the grid."""

    figures: dict[str, Any]
    heights: HeightError


def evaluate(
    height_map: HeightMap,
    motion: Motion,
    reference: int,
    truth: SimulationTruth,
    *,
    mesh: SurfaceMesh | None = None,
    alignments: tuple[AlignmentKind, ...] = ALIGNMENTS,
) -> Evaluation:
    """Compare a result with the truth of its simulated series.

    Parameters
    ----------
    height_map : HeightMap
        The result's heights in um.
    motion : Motion
        Its views, in the order of the truth's.
    reference : int
        The view whose grid the height map has.
    truth : SimulationTruth
    mesh : SurfaceMesh, optional
        The result's mesh; made from the height map where left out.
    alignments : tuple of str
        For the surface distances. They begin where the reference view's rays lay the result over the truth, but "none",
        which takes the files as they are, the free origin of the heights included.

    Returns
    -------
    Evaluation
        `figures` holds `views` (see `tilt_figures`), `heights` (see `height_figures`), `lateral` (see
        `transmission_figures`), and under `surface` those of `surface_figures` per alignment. All of the true surface
        that at least two views see is expected of a result.

    Raises
    ------
    BadInputError
        If the result is in px: without a pixel size it has no size to compare.

    Examples
    --------
    >>> import semscape
    >>> from semscape.simulate import SimulationOptions, simulate
    >>> small = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=256, height_px=256)
    >>> series, truth = simulate("fracture", small, rng=0)
    >>> result = semscape.reconstruct(series, rng=0)
    >>> found = result.reconstruction
    >>> evaluation = evaluate(result.height_map, found.motion, found.reference, truth, alignments=("rigid",))
    >>> evaluation.figures["surface"]["rigid"]["median_px"] < 2
    True
    """
    if height_map.length_unit != "um":
        raise BadInputError(
            "the result's lengths are in px and the truth's in um; reconstruct with --pixel-size-um to compare them"
        )
    units = true_units(height_map, truth)
    heights = height_error(height_map, motion, reference, truth)
    ours = height_map_mesh(height_map, max_vertices=_MESH_VERTICES) if mesh is None else mesh
    found = make_surface(ours.vertices_um, ours.faces)
    surface = true_surface(truth)
    compared = np.isfinite(heights.error_um)
    grid = np.stack([*np.indices(compared.shape)[::-1], height_map.height_um, np.ones(compared.shape)], axis=-1)
    points = (grid @ height_map.world_from_grid[:3].T)[compared]
    figures = {
        "length_unit": "um",
        "pixel_size_um": height_map.pixel_size_um,
        "relief_um": units.relief_um,
        "views": tilt_figures(motion, reference, truth),
        "heights": height_figures(height_map, heights, units),
        "lateral": transmission_figures(height_map, height_map.height_um - heights.error_um),
        "surface": {
            kind: surface_figures(
                found, surface, kind, units, start=align_points(points, heights.true_um[compared], kind)
            )
            for kind in alignments
        },
    }
    return Evaluation(figures, heights)


def true_surface(truth: SimulationTruth) -> Surface:
    """Return the true surface of a simulated series; what fewer than two views see does not count as missing."""
    shape = truth.height_um.shape
    seen = truth.visible.sum(axis=0)
    as_map = HeightMap(
        height_um=truth.height_um,
        uncertainty_um=np.full(shape, np.nan),
        n_views=seen.astype(np.uint8),
        texture=np.full(shape, np.nan, dtype=np.float32),
        pixel_size_um=truth.pixel_size_um,
        world_from_grid=truth.world_from_grid,
        length_unit="um",
    )
    mesh = height_map_mesh(as_map, max_vertices=_MESH_VERTICES, steepest_slope=np.inf)
    centre = np.column_stack([mesh.vertices_um[mesh.faces].mean(axis=1), np.ones(len(mesh.faces))])
    col, row, *_ = np.rint(np.linalg.inv(truth.world_from_grid) @ centre.T).astype(np.int64)
    return make_surface(mesh.vertices_um, mesh.faces, seen[row, col] >= _LEAST_VIEWS)
