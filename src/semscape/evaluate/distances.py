"""Distances between an aligned result and a true surface, both ways, and what is told of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from semscape.evaluate.align import Alignment, AlignmentKind, align_to_surface
from semscape.evaluate.surface import Surface, closest
from semscape.evaluate.units import Units, rounded
from semscape.types import FloatArray, IntArray

_SAMPLES = 40_000
_ALIGNMENT_SAMPLES = 4_000


@dataclass(frozen=True, eq=False)
class Cloud:
    """A result without triangles: `points_um` (P, 3)."""

    points_um: FloatArray


def surface_figures(
    found: Surface | Cloud, truth: Surface, kind: AlignmentKind, units: Units, start: Alignment | None = None
) -> dict[str, float]:
    """Align a mesh or a cloud of points to a true surface and return the figures of the distances.

    Parameters
    ----------
    found : Surface or Cloud
        The result in um.
    truth : Surface
        `counted` says which of its triangles a complete result holds.
    kind : "similarity", "rigid" or "none"
        What is fitted; "none" takes `start` as it is.
    units : Units
        Pixel size, which is also the limit of completeness, and relief.
    start : Alignment, optional
        Where the alignment begins; the result's own frame where left out.

    Returns
    -------
    dict
        `rmse`, `median` and `p95` of the distances from the result to the truth; `chamfer`, the mean of the mean
        distances in both directions; `hausdorff` and `hausdorff_p95`, the larger of both directions; each in um, px
        and percent of relief. `normal_angle_mean_deg` and `normal_angle_median_deg` of the result against the truth
        beside it (NaN for a cloud), `completeness_1px` (the share of the true area within one px of the result), and
        the alignment's `scale`, `turn_deg` and `shift_um`.

    Raises
    ------
    ValueError
        If the result has no points.

    Examples
    --------
    >>> from semscape.evaluate.surface import make_surface
    >>> square = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    >>> truth, raised = make_surface(*square), make_surface(square[0] + (0, 0, 0.5), square[1])
    >>> figures = surface_figures(raised, truth, "none", Units(pixel_size_um=0.1, relief_um=2.0))
    >>> figures["rmse_um"], figures["hausdorff_px"], figures["chamfer_percent_of_relief"]
    (0.5, 5.0, 25.0)
    """
    points = found.points_um if isinstance(found, Cloud) else found.centroids
    if not len(points):
        raise ValueError("a result without points cannot be compared")
    alignment = align_to_surface(points[_thinned(len(points), _ALIGNMENT_SAMPLES)], truth, kind, start)
    chosen = _thinned(len(points), _SAMPLES)
    foot = closest(truth, alignment.apply(points[chosen]))
    to_truth = foot.distance
    wanted = np.flatnonzero(truth.counted)
    wanted = wanted[_thinned(len(wanted), _SAMPLES)]
    true_weight = truth.area[wanted]
    # The truth's points go into the result's frame, so that one search tree serves every alignment.
    true_points = alignment.undo(truth.centroids[wanted])
    if isinstance(found, Cloud):
        weight, angle_deg = np.ones(len(chosen)), np.full(len(chosen), np.nan)
        to_found = alignment.scale * np.asarray(cKDTree(points).query(true_points)[0])
    else:
        weight = found.area[chosen]
        cosine = np.einsum("ij,ij->i", found.normals[chosen] @ alignment.rotation.T, foot.normals)
        angle_deg = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
        to_found = alignment.scale * closest(found, true_points).distance
    mean_distance = (np.average(to_truth, weights=weight) + np.average(to_found, weights=true_weight)) / 2
    p95, p95_of_truth = quantile(to_truth, weight, 0.95), quantile(to_found, true_weight, 0.95)
    moved = alignment.apply(points).mean(axis=0) - points.mean(axis=0)
    return {
        **units.told("rmse", float(np.sqrt(np.average(to_truth**2, weights=weight)))),
        **units.told("median", quantile(to_truth, weight, 0.5)),
        **units.told("p95", p95),
        **units.told("chamfer", float(mean_distance)),
        **units.told("hausdorff", float(max(to_truth.max(), to_found.max()))),
        **units.told("hausdorff_p95", max(p95, p95_of_truth)),
        "normal_angle_mean_deg": rounded(float(np.average(angle_deg, weights=weight)), 4),
        "normal_angle_median_deg": rounded(quantile(angle_deg, weight, 0.5), 4),
        "completeness_1px": rounded(float(np.average(to_found <= units.pixel_size_um, weights=true_weight)), 5),
        "scale": rounded(alignment.scale, 7),
        "turn_deg": rounded(float(np.rad2deg(alignment.angle_rad)), 5),
        "shift_um": rounded(float(np.linalg.norm(moved)), 5),
    }


def quantile(values: FloatArray, weight: FloatArray, share: float) -> float:
    """Return the value (N,) below which `share` of the weight (N,) lies.

    Examples
    --------
    >>> quantile(np.array([3.0, 1.0, 2.0]), np.array([1.0, 5.0, 1.0]), 0.5)
    1.0
    """
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(below, share * below[-1])]])


def _thinned(count: int, most: int) -> IntArray:
    """Return at most so many of `count` indices, evenly spaced; over a surface, that is evenly in place."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)
