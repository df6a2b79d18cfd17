"""Views under perspective become views under parallel projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.dense.parallel import as_parallel
from semscape.geometry.cameras import camera_matrices
from semscape.types import FloatArray, Micrograph, Motion, Reconstruction, SemMetadata, TiltSeries
from synthetic_result import make_result

SIZE = 160
CENTRE = (SIZE - 1) / 2
INVERSE_DISTANCE = 1 / 100
MOTION = Motion(
    axis_angle_rad=np.deg2rad(80.0),
    tilt_rad=np.deg2rad([-8.0, 8.0]),
    roll_rad=np.deg2rad([0.5, -0.5]),
    scale_px_per_um=np.array([10.0, 10.02]),
    anisotropy=np.zeros(2),
    translation_px=np.array([[CENTRE + 3, CENTRE - 2], [CENTRE - 4, CENTRE + 1]]),
)
ROWS, COLS = np.indices((SIZE, SIZE))


def ground_of(seen: FloatArray, view: int, inverse_distance: float) -> FloatArray:
    """Return the points (N, 2) um of height zero that a view sees at px (N, 2), by its own equations."""
    matrix, shift = camera_matrices(MOTION)[view], MOTION.translation_px[view]
    third = np.cross(matrix[0], matrix[1]) / MOTION.scale_px_per_um[view] ** 2
    # c + (M X + t - c) / (1 + k r X) = x is linear in X: (M - (x - c) k r) X = x - t
    left = matrix[:, :2] - (seen - CENTRE)[:, :, None] * inverse_distance * third[:2]
    return np.linalg.solve(left, (seen - shift)[:, :, None])[:, :, 0]


def picture(view: int, inverse_distance: float) -> np.ndarray:
    x, y = ground_of(np.stack([COLS.ravel(), ROWS.ravel()], axis=1), view, inverse_distance).T
    return (100 + 50 * np.sin(2.5 * x) * np.cos(2.1 * y)).reshape(SIZE, SIZE).astype(np.float32)


def series_of(inverse_distance: float) -> TiltSeries:
    mask = np.ones((SIZE, SIZE), bool)
    return TiltSeries(
        tuple(
            Micrograph(f"{i}.tif", picture(i, inverse_distance), mask, SemMetadata(pixel_size_um=0.1)) for i in (0, 1)
        )
    )


@pytest.fixture
def reconstruction() -> Reconstruction:
    return replace(
        make_result().reconstruction, motion=MOTION, camera="perspective", inverse_distance_per_um=INVERSE_DISTANCE
    )


def test_the_plane_is_seen_as_in_parallel_projection(reconstruction: Reconstruction) -> None:
    seen, flat = series_of(INVERSE_DISTANCE), series_of(0.0)
    for bent, view, true in zip(seen.views, as_parallel(seen, reconstruction).views, flat.views, strict=True):
        inner = view.mask.copy()
        inner[:3], inner[-3:], inner[:, :3], inner[:, -3:] = False, False, False, False
        assert inner.mean() > 0.85
        assert np.abs(bent.image - true.image)[inner].max() > 5
        assert np.abs(view.image - true.image)[inner].max() < 1.0


def test_parallel_projection_stays_as_it_is(reconstruction: Reconstruction) -> None:
    series = series_of(0.0)
    assert as_parallel(series, replace(reconstruction, camera="orthographic")) is series
