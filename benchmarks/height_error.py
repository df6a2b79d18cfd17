"""Errors of a reconstruction against the exact truth of a simulated series.

The result is laid over the truth by what a user cannot choose: both are seen by the same reference view, so a
point of our grid belongs to the point of the true surface that the true camera images at the same pixel. No
scale is fitted, but for the shape error, which is free of it. What the images of a tilt series cannot tell is
taken out of the height errors: the origin of the heights, and a common turn of all views, which leans the whole
surface. To first order that is a plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from semscape.geometry.cameras import camera_matrices
from semscape.types import FloatArray, HeightMap, Reconstruction, SimulationTruth

_FIXED_POINT_STEPS = 12
_CLIPPING_ROUNDS = 8


@dataclass(frozen=True)
class HeightError:
    """Height errors over our grid in px of the grid, NaN where either surface is unknown, and the height scale.

    `error_px` (H, W) is free of the best plane; `shape_error_px` (H, W) of the best plane and the best height scale;
    `scale` is the slope of our heights over the true ones, 1 for a perfect height scale.
    """

    error_px: FloatArray
    shape_error_px: FloatArray
    scale: float


def tilt_figures(reconstruction: Reconstruction, truth: SimulationTruth) -> dict[str, Any]:
    """Return the tilt errors in deg: as they are, without what no image can tell, and the stage's own."""
    error = np.rad2deg(reconstruction.motion.tilt_rad - truth.motion.tilt_rad)
    stage = np.rad2deg(truth.stage_tilt_rad - truth.motion.tilt_rad)
    # What the stage alone can tell: a common turn, and the height scale, to which all tilts are proportional.
    true_tilt = np.rad2deg(truth.motion.tilt_rad)
    design = np.column_stack([np.ones(len(error)), true_tilt - true_tilt.mean()])
    seen_by_images = error - design @ np.linalg.lstsq(design, error, rcond=None)[0]
    return {
        "tilt_error_deg": _rounded(error, 4),
        "tilt_error_without_common_deg": _rounded(error - error.mean(), 4),
        "largest_tilt_error_without_common_deg": round(float(np.abs(error - error.mean()).max()), 4),
        "tilt_rms_error_deg": round(float(np.sqrt(np.mean(error**2))), 4),
        "largest_tilt_error_that_images_show_deg": round(float(np.abs(seen_by_images).max()), 4),
        "stage_tilt_error_deg": _rounded(stage, 4),
        "stage_tilt_rms_error_deg": round(float(np.sqrt(np.mean(stage**2))), 4),
    }


def height_error(height_map: HeightMap, reconstruction: Reconstruction, truth: SimulationTruth) -> HeightError:
    """Compare a height map, made with the cameras of `reconstruction`, with the truth."""
    height = height_map.height_um
    rows, cols = np.indices(height.shape, dtype=np.float64)
    seen_px = _project(height_map, cols, rows, reconstruction)
    true_height = _true_height_at(seen_px, truth, reconstruction.reference).reshape(height.shape)
    known = np.isfinite(height) & np.isfinite(true_height)

    plane = np.column_stack([cols[known], rows[known], np.ones(known.sum())])
    difference = height[known] - true_height[known]
    lean = _robust_fit(plane, difference)
    error = np.full(height.shape, np.nan)
    error[known] = (difference - plane @ lean) / height_map.pixel_size_um
    with_scale = np.column_stack([true_height[known], plane])
    scaled = _robust_fit(with_scale, height[known])
    shape_error = np.full(height.shape, np.nan)
    shape_error[known] = (height[known] - with_scale @ scaled) / height_map.pixel_size_um
    return HeightError(error, shape_error, float(scaled[0]))


def height_figures(height_map: HeightMap, reconstruction: Reconstruction, truth: SimulationTruth) -> dict[str, Any]:
    """Return the figures of a height map's errors; lengths in px of the grid."""
    found = height_error(height_map, reconstruction, truth)
    compared = np.isfinite(found.error_px)
    error = np.abs(found.error_px[compared])
    sigma = height_map.uncertainty_um[compared] / height_map.pixel_size_um
    relief = float(np.nanmax(truth.height_um) - np.nanmin(truth.height_um)) / truth.pixel_size_um
    figures = {
        "median_abs_error_px": round(float(np.median(error)), 4),
        "rmse_px": round(float(np.sqrt(np.mean(error**2))), 4),
        "p95_abs_error_px": round(float(np.percentile(error, 95)), 4),
        "rmse_percent_of_relief": round(100 * float(np.sqrt(np.mean(error**2))) / relief, 3),
        "median_abs_shape_error_px": round(float(np.nanmedian(np.abs(found.shape_error_px))), 4),
        "height_scale_error_percent": round(100 * (found.scale - 1), 3),
        "completeness": round(float(np.isfinite(height_map.height_um).mean()), 4),
    }
    if np.isfinite(sigma).any():
        figures["within_1_sigma"] = round(float((error < sigma).mean()), 4)
        figures["median_uncertainty_px"] = round(float(np.median(sigma)), 4)
    return figures


def _robust_fit(design: FloatArray, values: FloatArray) -> FloatArray:
    """Return the least-squares coefficients without the values beyond 4 robust sigmas: false heights are no lean."""
    kept = np.ones(len(values), dtype=bool)
    for _ in range(_CLIPPING_ROUNDS):
        coefficients, *_ = np.linalg.lstsq(design[kept], values[kept], rcond=None)
        residual = np.abs(values - design @ coefficients)
        kept = residual <= 4 * 1.4826 * np.median(residual) + 1e-12
    return coefficients


def _project(height_map: HeightMap, cols: FloatArray, rows: FloatArray, reconstruction: Reconstruction) -> FloatArray:
    """Return where our reference camera sees the points of the grid, (2, N) px."""
    reference = reconstruction.reference
    grid = np.stack([cols.ravel(), rows.ravel(), np.nan_to_num(height_map.height_um).ravel(), np.ones(cols.size)])
    world = (height_map.world_from_grid @ grid)[:3]
    seen: FloatArray = camera_matrices(reconstruction.motion)[reference] @ world
    return seen + reconstruction.motion.translation_px[reference][:, None]


def _true_height_at(seen_px: FloatArray, truth: SimulationTruth, view: int) -> FloatArray:
    """Return the height of the true surface on the rays of pixels (2, N) of a true view, by fixed-point steps."""
    matrix = camera_matrices(truth.motion)[view]
    grid_from_world = np.linalg.inv(truth.world_from_grid)
    offset = seen_px - truth.motion.translation_px[view][:, None]
    filled = np.where(np.isfinite(truth.height_um), truth.height_um, np.nanmedian(truth.height_um))
    height = np.full(seen_px.shape[1], np.median(filled))
    for _ in range(_FIXED_POINT_STEPS):
        x, y = np.linalg.solve(matrix[:, :2], offset - matrix[:, 2:3] * height)
        col, row, *_ = grid_from_world @ np.stack([x, y, np.zeros_like(x), np.ones_like(x)])
        height = map_coordinates(filled, [row, col], order=1, mode="nearest")
    unknown = map_coordinates((~np.isfinite(truth.height_um)).astype(np.float64), [row, col], order=1, mode="nearest")
    return np.where(unknown > 0, np.nan, height)


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
