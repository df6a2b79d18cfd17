"""Two views side by side as two eyes would see them: epipolar lines are rows, hills come towards the viewer."""

from __future__ import annotations

import numpy as np

from semscape.dense.mesh import grey_levels
from semscape.dense.rectify import Frame, warp_to_frame
from semscape.geometry.cameras import camera_matrices
from semscape.types import FloatArray, Motion, TiltSeries


def stereo_views(motion: Motion, angle_rad: float) -> tuple[int, int]:
    """Return the views of the left and of the right eye: those whose tilts differ by what is closest to an angle.

    A point of height h lies at u + h tan(tilt). What is near lies further right for the left eye, so the left eye
    gets the larger tilt.

    Examples
    --------
    >>> motion = Motion(0.0, np.deg2rad([-8.0, -3.0, 0.0, 4.0]), *np.zeros((4, 4)))
    >>> stereo_views(motion, np.deg2rad(7.0))
    (3, 1)
    """
    tilt = motion.tilt_rad
    difference = tilt[:, None] - tilt[None, :]
    left, right = np.unravel_index(np.argmin(np.abs(difference - angle_rad)), difference.shape)
    return int(left), int(right)


def stereo_pair(
    series: TiltSeries, motion: Motion, reference: int, pixel_size_um: float, eyes: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Return the pictures of the left and the right eye, (H, W) grey from 0 to 255, 0 where nothing was imaged.

    The tilt axis stands upright in both; heights of zero, the median of the surface, coincide.

    Parameters
    ----------
    series : TiltSeries
        The views, in the order of `motion`.
    motion : Motion
        Their calibrated motion.
    reference : int
        The view whose field the pictures show.
    pixel_size_um : float
        Pixel size of the pictures.
    eyes : (int, int)
        The views of the left and the right eye.
    """
    frame = _reference_frame(series, motion, reference, pixel_size_um)
    pictures = []
    for index in eyes:
        image, inside = warp_to_frame(series.views[index], index, motion, frame)
        pictures.append(grey_levels(np.where(inside, image, np.nan).astype(np.float32)).astype(np.float64))
    return pictures[0], pictures[1]


def _reference_frame(series: TiltSeries, motion: Motion, reference: int, pixel_size_um: float) -> Frame:
    """Return the grid over height zero that holds the reference view's field, u across the tilt axis."""
    sin, cos = np.sin(motion.axis_angle_rad), np.cos(motion.axis_angle_rad)
    directions = pixel_size_um * np.array([[sin, -cos], [-cos, -sin]])
    height, width = series.shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], dtype=np.float64)
    view_from_world = camera_matrices(motion)[reference][:, :2]
    world = np.linalg.solve(view_from_world, (corners - motion.translation_px[reference]).T)
    uv = np.linalg.solve(directions, world).T
    low = np.floor(uv.min(axis=0))
    columns, rows = (int(size) + 1 for size in np.ceil(uv.max(axis=0) - low))
    return Frame(
        np.column_stack([directions, directions @ low]), (rows, columns), pixel_size_um, np.tan(motion.tilt_rad)
    )
