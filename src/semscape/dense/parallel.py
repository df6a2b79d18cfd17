"""Views under perspective, resampled to what parallel projection would have shown; dense steps know no other."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from semscape.geometry.cameras import camera_matrices, perspective_cameras_of
from semscape.types import FloatArray, Micrograph, Reconstruction, TiltSeries

_WHOLLY_IMAGED = 0.999


def as_parallel(series: TiltSeries, reconstruction: Reconstruction) -> TiltSeries:
    """Return the series as parallel projection would have shown it, the same one where it is parallel already.

    It is exact for points of height zero. A point z above them, at a distance k z of that of the centre of projection,
    stays k z of its way from the middle of the field too far out, in all views alike but for 1 / cos(tilt): so it is
    seen a little beside its place, but its height is right.

    Parameters
    ----------
    series : TiltSeries
    reconstruction : Reconstruction
        Of the same views.
    """
    if reconstruction.camera != "perspective":
        return series
    rows, columns = series.shape
    centre_px = np.array([(columns - 1) / 2, (rows - 1) / 2])
    motion = reconstruction.motion
    cameras = perspective_cameras_of(motion, reconstruction.inverse_distance_per_um, centre_px)
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    views = []
    for view, camera, matrix, shift in zip(
        series.views, cameras, camera_matrices(motion), motion.translation_px, strict=True
    ):
        ground = np.zeros((len(pixels), 3))
        ground[:, :2] = np.linalg.solve(matrix[:, :2], (pixels - shift).T).T
        views.append(_resampled(view, camera.project(ground).reshape(rows, columns, 2)))
    return replace(series, views=tuple(views))


def _resampled(view: Micrograph, seen_px: FloatArray) -> Micrograph:
    x, y = seen_px.astype(np.float32).transpose(2, 0, 1)
    image = cv2.remap(view.image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    inside = cv2.remap(view.mask.astype(np.float32), x, y, cv2.INTER_LINEAR)
    return replace(view, image=image, mask=inside > _WHOLLY_IMAGED)
