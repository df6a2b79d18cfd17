"""SURF (Bay et al. 2008) from mahotas, with positions interpolated anew.

mahotas (1.4) interpolates the maximum of its response against the gradient instead of along it, with row and
column exchanged: rendered blobs come out as far on the wrong side of the pixel's centre as they lie on the right
one. So the nearest pixel and filter size are taken back from its answer, and the quadratic is solved here, over the
same box filters. mahotas also leaves a margin at the coarse octaves that grows with the square of the scale; here
each octave is a run over the image of half the size.
"""

from __future__ import annotations

import cv2
import numpy as np
from mahotas.features import surf
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.features.found import Found, least_blob_height
from semscape.types import FloatArray, Keypoints

# SURF's descriptors have unit length; as whole numbers of this size their products are exact in float32.
_LEVELS = 1023
_OCTAVES = 4
_FILTERS = 6
_LEAST_SIZE_PX = 64
# The descriptor's grid is 20 scales wide; a scale in mahotas is 0.4 lobes of the filter.
_REACH_IN_SCALES = 10.0
_SCALE_PER_LOBE = 0.4
# The determinant at the centre of a blob of unit height that fits the filter.
_RESPONSE_OF_UNIT_BLOB = 0.030


def find_surf(image: NDArray[np.uint8], contrast_threshold: float) -> Found:
    """Find and describe the blobs of an image (H, W) where the determinant of the Hessian peaks.

    References
    ----------
    Bay et al. 2008, doi:10.1016/j.cviu.2007.09.014
    """
    level = image.astype(np.float64)
    threshold = _RESPONSE_OF_UNIT_BLOB * least_blob_height(contrast_threshold) ** 2
    rows = []
    for octave in range(_OCTAVES):
        if min(level.shape) < _LEAST_SIZE_PX:
            break
        found = _find_in_octave(surf.integral(level), threshold)
        # The level's pixel (0, 0) covers 2^octave pixels of the image: its centre is not theirs.
        found[:, :2] = (found[:, :2] + 0.5) * 2**octave - 0.5
        found[:, 2] *= 2**octave
        rows.append(found)
        even = level[: level.shape[0] // 2 * 2, : level.shape[1] // 2 * 2]
        level = cv2.resize(even, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA)
    found = np.concatenate(rows) if rows else np.empty((0, 70))
    y, x, scale, response, _, angle = found[:, :6].T
    keypoints = Keypoints(
        xy=np.column_stack([x, y]),
        scale_px=scale,
        # mahotas measures the direction of getting darker, from the downward axis to the right.
        orientation_rad=np.arctan2(-np.cos(angle), -np.sin(angle)) % (2 * np.pi),
        response=np.sqrt(response / _RESPONSE_OF_UNIT_BLOB),
        descriptors=np.rint(_LEVELS * found[:, 6:]).astype(np.float32),
        kind="surf",
    )
    return Found(keypoints, _REACH_IN_SCALES * scale)


def _find_in_octave(integral: FloatArray, threshold: float) -> FloatArray:
    """Return mahotas' rows (y, x, scale, response, sign, angle, descriptor) of the finest octave, interpolated anew."""
    points = surf.interest_points(integral, 1, _FILTERS, 1, threshold, is_integral=True)
    if len(points) == 0:
        return np.empty((0, 70))
    pixel = np.rint(points[:, :2]).astype(np.int64)
    size = np.rint((points[:, 2] / _SCALE_PER_LOBE - 3) / 2).astype(np.int64)
    step = np.empty((len(points), 3))
    _interpolate(integral, pixel, size, step)
    inside = np.abs(step).max(axis=1) <= 1.0
    points[:, :2] = pixel + step[:, :2]
    points[:, 2] = _SCALE_PER_LOBE * (2 * (size + step[:, 2]) + 3)
    described: FloatArray = surf.descriptors(integral, points[inside], is_integral=True)
    return described


@njit(cache=True, nogil=True)
def _interpolate(integral: FloatArray, pixel: NDArray[np.int64], size: NDArray[np.int64], step: FloatArray) -> None:
    """Write to `step` (N, 3) where parabolas through the neighbouring responses peak: rows, columns, filter sizes.

    Place and size are fitted apart: their mixed terms, of two filters of whole pixels, would shift the place.
    """
    value = np.empty((3, 3))
    for n in range(len(pixel)):
        y, x, lobe = pixel[n, 0], pixel[n, 1], 2 * size[n] + 3
        for r in range(3):
            for c in range(3):
                value[r, c] = _determinant(integral, y + r - 1, x + c - 1, lobe)
        centre = value[1, 1]
        gr, gc = (value[2, 1] - value[0, 1]) / 2, (value[1, 2] - value[1, 0]) / 2
        rr, cc = value[2, 1] + value[0, 1] - 2 * centre, value[1, 2] + value[1, 0] - 2 * centre
        rc = (value[2, 2] + value[0, 0] - value[2, 0] - value[0, 2]) / 4
        finer, coarser = _determinant(integral, y, x, lobe - 2), _determinant(integral, y, x, lobe + 2)
        curvature = coarser + finer - 2 * centre
        determinant = rr * cc - rc * rc
        if rr >= 0 or determinant <= 0 or curvature >= 0:
            step[n] = np.inf
            continue
        step[n, 0] = (rc * gc - cc * gr) / determinant
        step[n, 1] = (rc * gr - rr * gc) / determinant
        step[n, 2] = (finer - coarser) / (2 * curvature)


@njit(cache=True, nogil=True)
def _determinant(integral: FloatArray, y: int, x: int, lobe: int) -> float:
    """Return the box-filtered determinant of the Hessian at a pixel, as mahotas defines it."""
    wide, long, shift = 2 * lobe - 1, 3 * lobe, lobe // 2 + 1
    yy = _box(integral, y, x, long, wide) - 3 * _box(integral, y, x, lobe, wide)
    xx = _box(integral, y, x, wide, long) - 3 * _box(integral, y, x, wide, lobe)
    xy = (
        _box(integral, y - shift, x + shift, lobe, lobe)
        + _box(integral, y + shift, x - shift, lobe, lobe)
        - _box(integral, y - shift, x - shift, lobe, lobe)
        - _box(integral, y + shift, x + shift, lobe, lobe)
    )
    area = float(long * long)
    determinant: float = (xx * yy - 0.36 * xy * xy) / (area * area)
    return determinant


@njit(cache=True, nogil=True)
def _box(integral: FloatArray, y: int, x: int, height: int, width: int) -> float:
    """Return the sum over a box of odd sides about a pixel, cut off at the image's border."""
    top, left = max(y - height // 2 - 1, 0), max(x - width // 2 - 1, 0)
    bottom = min(y + height // 2, integral.shape[0] - 1)
    right = min(x + width // 2, integral.shape[1] - 1)
    total: float = (integral[bottom, right] - integral[top, right]) - (integral[bottom, left] - integral[top, left])
    return total
