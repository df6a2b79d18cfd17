"""Errors of a height map against the exact truth of a simulated series, point by point in its grid.

The result is laid over the truth by what a user cannot choose: both are seen by the same reference view, so a
point of our grid belongs to the point of the true surface that the true camera images at the same pixel, its skew and
perspective left out: what a result does not undo of them is an error of its own. No scale is fitted, but for the shape
error, which is free of it. What the images of a tilt series cannot tell is taken out of the height errors: the origin
of the heights, and a common turn of all views, which leans the whole surface. To first order that is a plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from semscape.evaluate.units import Units, rounded
from semscape.geometry.cameras import camera_matrices
from semscape.types import BoolArray, FloatArray, HeightMap, Motion, SimulationTruth

_FIXED_POINT_STEPS = 12
_CLIPPING_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class HeightError:
    """Height errors over a result's grid (H, W) in um, NaN where either surface is unknown, and the height scale.

    `error_um` is free of the best plane, `shape_error_um` of the best plane and the best height scale; `scale` is the
    slope of the heights over the true ones, 1 for a perfect height scale. `normal_angle_rad` is the angle between the
    two surfaces' normals. `true_um` (H, W, 3) is the point of the true surface that belongs to each point of the grid,
    NaN where there is none, and `seen` whether the reference view really sees it.
    """

    error_um: FloatArray
    shape_error_um: FloatArray
    scale: float
    normal_angle_rad: FloatArray
    true_um: FloatArray
    seen: BoolArray


def true_units(height_map: HeightMap, truth: SimulationTruth) -> Units:
    """Return what errors are measured against: the grid's pixel size and the truth's relief."""
    return Units(height_map.pixel_size_um, float(np.nanmax(truth.height_um) - np.nanmin(truth.height_um)))


def height_error(height_map: HeightMap, motion: Motion, reference: int, truth: SimulationTruth) -> HeightError:
    """Compare a height map with the truth.

    Parameters
    ----------
    height_map : HeightMap
        In um, made with the cameras of `motion`.
    motion : Motion
        The result's views, in the order of the truth's.
    reference : int
        The view whose grid the height map has.
    truth : SimulationTruth

    Returns
    -------
    HeightError

    Raises
    ------
    ValueError
        If fewer than four points can be compared.
    """
    height = height_map.height_um
    pixel = height_map.pixel_size_um
    grid = np.indices(height.shape).astype(np.float64)
    rows, cols = grid[0], grid[1]
    seen_px = _project(height_map, cols, rows, motion, reference)
    true_um, at_truth = _true_points(seen_px, truth, reference)
    true_um = true_um.reshape(*height.shape, 3)
    true_height = true_um[..., 2]
    known = np.isfinite(height) & np.isfinite(true_height)
    if known.sum() < 4:
        raise ValueError(f"only {known.sum()} points are known in both the height map and the truth, need 4")

    plane = np.column_stack([cols[known], rows[known], np.ones(known.sum())])
    difference = height[known] - true_height[known]
    lean = _robust_fit(plane, difference)
    error = np.full(height.shape, np.nan)
    error[known] = difference - plane @ lean
    with_scale = np.column_stack([true_height[known], plane])
    scaled = _robust_fit(with_scale, height[known])
    shape_error = np.full(height.shape, np.nan)
    shape_error[known] = height[known] - with_scale @ scaled

    upright = height - (cols * lean[0] + rows * lean[1])
    angle = _angle(_normals(upright, pixel), _resampled_normals(truth, at_truth, height.shape))
    seen = _resampled(truth.visible[reference].astype(np.float64), at_truth).reshape(height.shape) > 0.5
    return HeightError(error, shape_error, float(scaled[0]), angle, true_um, seen)


def height_figures(height_map: HeightMap, found: HeightError, units: Units) -> dict[str, Any]:
    """Return the figures of a height map's errors, lengths in um, px of the grid and percent of relief.

    `completeness` is the share of the grid with a height, `completeness_1px` the share, among the true points that the
    reference view sees, with a height that is right within one px, and `within_1_sigma` the share of errors below the
    map's own uncertainty.
    """
    compared = np.isfinite(found.error_um)
    error = np.abs(found.error_um[compared])
    sigma = height_map.uncertainty_um[compared]
    true = np.isfinite(found.true_um[..., 2]) & found.seen
    right = np.abs(found.error_um) <= units.pixel_size_um  # False for NaN
    angle_deg = np.rad2deg(found.normal_angle_rad[np.isfinite(found.normal_angle_rad)])
    figures = {
        **units.told("median_abs_error", float(np.median(error))),
        **units.told("rmse", float(np.sqrt(np.mean(error**2)))),
        **units.told("p95_abs_error", float(np.percentile(error, 95))),
        **units.told("median_abs_shape_error", float(np.nanmedian(np.abs(found.shape_error_um)))),
        **units.told("shape_rmse", float(np.sqrt(np.nanmean(found.shape_error_um**2)))),
        "height_scale_error_percent": rounded(100 * (found.scale - 1), 4),
        "normal_angle_mean_deg": rounded(float(angle_deg.mean()), 4) if angle_deg.size else np.nan,
        "normal_angle_median_deg": rounded(float(np.median(angle_deg)), 4) if angle_deg.size else np.nan,
        "completeness": rounded(float(np.isfinite(height_map.height_um).mean()), 4),
        "completeness_1px": rounded(float(right[true].mean()), 4) if true.any() else np.nan,
    }
    if np.isfinite(sigma).any():
        figures["within_1_sigma"] = rounded(float((error < sigma).mean()), 4)
        figures["median_uncertainty_px"] = rounded(float(np.median(sigma)) / units.pixel_size_um, 4)
    return figures


def _robust_fit(design: FloatArray, values: FloatArray) -> FloatArray:
    """Return the least-squares coefficients without the values beyond 4 robust sigmas: false heights are no lean."""
    kept = np.ones(len(values), dtype=np.bool_)
    coefficients: FloatArray = np.zeros(design.shape[1])
    for _ in range(_CLIPPING_ROUNDS):
        coefficients = np.linalg.lstsq(design[kept], values[kept], rcond=None)[0].astype(np.float64)
        residual = np.abs(values - design @ coefficients)
        kept = residual <= 4 * 1.4826 * np.median(residual) + 1e-12
    return coefficients


def _project(height_map: HeightMap, cols: FloatArray, rows: FloatArray, motion: Motion, reference: int) -> FloatArray:
    """Return where our reference camera sees the points of the grid, (2, N) px."""
    grid = np.stack([cols.ravel(), rows.ravel(), np.nan_to_num(height_map.height_um).ravel(), np.ones(cols.size)])
    world = (height_map.world_from_grid @ grid)[:3]
    seen: FloatArray = camera_matrices(motion)[reference] @ world
    seen += motion.translation_px[reference][:, None]
    return seen


def _true_points(seen_px: FloatArray, truth: SimulationTruth, view: int) -> tuple[FloatArray, FloatArray]:
    """Return the points (N, 3) of the true surface on the rays of pixels (2, N) of a true view, by fixed-point steps.

    NaN where the truth is unknown; the second array holds their positions (row, col) in the truth's grid, (2, N).
    """
    matrix = camera_matrices(truth.motion)[view]
    grid_from_world = np.linalg.inv(truth.world_from_grid)
    offset = seen_px - truth.motion.translation_px[view][:, None]
    filled = np.where(np.isfinite(truth.height_um), truth.height_um, np.nanmedian(truth.height_um))
    height = np.full(seen_px.shape[1], np.median(filled))
    for _ in range(_FIXED_POINT_STEPS):
        x, y = np.linalg.solve(matrix[:, :2], offset - matrix[:, 2:3] * height)
        col, row, *_ = grid_from_world @ np.stack([x, y, np.zeros_like(x), np.ones_like(x)])
        height = map_coordinates(filled, [row, col], order=1, mode="nearest")
    at = np.stack([row, col])
    unknown = _resampled((~np.isfinite(truth.height_um)).astype(np.float64), at)
    points = np.stack([x, y, height], axis=1)
    points[unknown > 0] = np.nan
    return points, at


def _resampled(values: FloatArray, at: FloatArray) -> FloatArray:
    sampled: FloatArray = map_coordinates(values, at, order=1, mode="nearest")
    return sampled


def _resampled_normals(truth: SimulationTruth, at: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    sampled = np.stack([_resampled(truth.normals[..., i], at) for i in range(3)], axis=-1)
    normals: FloatArray = sampled.reshape(*shape, 3)
    return normals


def _normals(height: FloatArray, pixel_size: float) -> FloatArray:
    """Return the unit normals (H, W, 3) of heights whose first row has the largest y; NaN beside unknown ones."""
    down, right = np.gradient(height, pixel_size)
    normals = np.stack([-right, down, np.ones_like(height)], axis=-1)
    unit: FloatArray = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    return unit


def _angle(first: FloatArray, second: FloatArray) -> FloatArray:
    cosine = (first * second).sum(axis=-1) / np.linalg.norm(second, axis=-1)
    angle: FloatArray = np.arccos(np.clip(cosine, -1, 1))
    return angle
