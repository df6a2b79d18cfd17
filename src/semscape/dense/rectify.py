"""Bring all views of a tilt series into one frame in which parallax runs along rows.

Every view of a single-axis series is an affine picture of the plane of height zero. Warped back onto that
plane, with the axes turned so that u runs across the tilt axis, a point of height h appears in view i at
u + h g_i with g_i = tan(tilt_i), and v is the same in all views: rows are epipolar lines for every pair at
once, with no distortion but the tilt's own foreshortening undone.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from semscape.geometry.cameras import camera_matrices
from semscape.types import BoolArray, FloatArray, ImageArray, Micrograph, Motion, Reconstruction, TiltSeries

_MARGIN_PX = 8
_FRAME_MULTIPLE = 64
# Frames begin at multiples of this from the world's origin, so that those of tiles share their pixels, halved ones too.
PHASE_PX = 16


@dataclass(frozen=True)
class Frame:
    """A regular grid over the world's plane of height zero: world_xy = world_from_frame @ (u, v, 1).

    `shape` is (rows, columns); `parallax` (V,) is g_i, in frame px of u per frame px of height.
    """

    world_from_frame: FloatArray
    shape: tuple[int, int]
    pixel_size_um: float
    parallax: FloatArray


def rectified_frame(series: TiltSeries, reconstruction: Reconstruction) -> Frame:
    """Return the frame that holds the reference view's field and the parallax of all its points."""
    motion = reconstruction.motion
    pixel_size = grid_pixel_size_um(series, reconstruction)
    sin, cos = np.sin(motion.axis_angle_rad), np.cos(motion.axis_angle_rad)
    # Columns: the world directions of u (across the axis, where a positive tilt moves a peak) and of v, which
    # is u turned clockwise on the screen.
    directions = pixel_size * np.array([[sin, -cos], [-cos, -sin]])
    corners_xy = _field_corners_um(series, reconstruction)
    corners_uv = np.linalg.solve(directions, corners_xy.T).T
    parallax = np.tan(motion.tilt_rad)
    height_px = np.abs(reconstruction.points_um[:, 2]).max() / pixel_size
    low, high = corners_uv.min(axis=0) - _MARGIN_PX, corners_uv.max(axis=0) + _MARGIN_PX
    reach = min(float(height_px * np.abs(parallax).max()), 0.25 * float(high[0] - low[0]))
    low[0], high[0] = low[0] - reach, high[0] + reach
    low = PHASE_PX * np.floor(low / PHASE_PX)
    columns, rows = (int(np.ceil(size / _FRAME_MULTIPLE)) * _FRAME_MULTIPLE for size in high - low)
    world_from_frame = np.column_stack([directions, directions @ low])
    return Frame(world_from_frame, (rows, columns), pixel_size, parallax)


def grid_pixel_size_um(series: TiltSeries, reconstruction: Reconstruction) -> float:
    """Return the pixel size of every grid: that of the reference view as told, before its drift."""
    return float(series.pixel_size_um[reconstruction.reference])


def warp_to_frame(view: Micrograph, index: int, motion: Motion, frame: Frame) -> tuple[ImageArray, BoolArray]:
    """Resample a view into the frame: image (rows, columns) float32 and where it holds imaged pixels."""
    view_from_frame = view_from_frame_map(index, motion, frame)
    size = (frame.shape[1], frame.shape[0])
    flags = cv2.WARP_INVERSE_MAP
    image = cv2.warpAffine(
        view.image, view_from_frame, size, flags=flags | cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    inside = cv2.warpAffine(view.mask.astype(np.float32), view_from_frame, size, flags=flags | cv2.INTER_LINEAR)
    return image, inside > 0.999


def view_from_frame_map(index: int, motion: Motion, frame: Frame) -> FloatArray:
    """Return the affine map (2, 3) from frame (u, v, 1) to view px at height zero."""
    matrix = camera_matrices(motion)[index]
    affine: FloatArray = matrix[:, :2] @ frame.world_from_frame
    affine[:, 2] += motion.translation_px[index]
    return affine


def _field_corners_um(series: TiltSeries, reconstruction: Reconstruction) -> FloatArray:
    """Return the world xy (4, 2) of the reference view's corners at height zero."""
    height, width = series.shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], dtype=np.float64)
    matrix = camera_matrices(reconstruction.motion)[reconstruction.reference]
    offset = corners - reconstruction.motion.translation_px[reconstruction.reference]
    world: FloatArray = np.linalg.solve(matrix[:, :2], offset.T).T
    return world
