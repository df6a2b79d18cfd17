from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.dense.stereo_pair import stereo_pair, stereo_views
from semscape.geometry.cameras import camera_matrices
from semscape.types import Micrograph, Motion, SemMetadata, TiltSeries

SIZE = 160
PIXEL = 0.5
HEIGHT_UM = 12.0


def make_series(axis_deg: float) -> tuple[TiltSeries, Motion]:
    """Two views of two bright dots, the first HEIGHT_UM above the second's level of zero."""
    motion = Motion(
        np.deg2rad(axis_deg), np.deg2rad([-3.0, 4.0]), np.zeros(2), np.full(2, 1 / PIXEL), np.zeros(2),
        np.full((2, 2), (SIZE - 1) / 2),
    )  # fmt: skip
    dots = np.array([[-8.0, 10.0, HEIGHT_UM], [9.0, -6.0, 0.0]])
    row, col = np.mgrid[:SIZE, :SIZE]
    views = []
    for matrix, shift in zip(camera_matrices(motion), motion.translation_px, strict=True):
        image = sum(np.exp(-((col - x) ** 2 + (row - y) ** 2) / 8) for x, y in dots @ matrix.T + shift)
        views.append(
            Micrograph("v", image.astype(np.float32), np.ones(image.shape, bool), SemMetadata(pixel_size_um=PIXEL), "d")
        )
    return TiltSeries(tuple(views)), motion


def dots_of(picture: np.ndarray) -> np.ndarray:
    """Return column and row of the two dots, the upper one first."""
    half = len(picture) // 2
    found = []
    for first_row, part in ((0, picture[:half]), (half, picture[half:])):
        y, x = np.indices(part.shape)
        found.append([(part * x).sum() / part.sum(), (part * y).sum() / part.sum() + first_row])
    return np.array(found)


@pytest.mark.parametrize("axis_deg", [90.0, 77.0])
def test_what_is_higher_comes_nearer_along_the_rows(axis_deg: float) -> None:
    series, motion = make_series(axis_deg)
    eyes = stereo_views(motion, np.deg2rad(7.0))
    assert eyes == (1, 0)
    left, right = stereo_pair(series, motion, 0, PIXEL, eyes)
    assert left.shape == right.shape
    shift = dots_of(left) - dots_of(right)
    expected = HEIGHT_UM / PIXEL * (np.tan(np.deg2rad(4.0)) - np.tan(np.deg2rad(-3.0)))
    # Nearer is further right for the left eye; the level of zero coincides; rows are epipolar lines.
    np.testing.assert_allclose(shift, [[expected, 0.0], [0.0, 0.0]], atol=0.1)


def test_a_vertical_axis_keeps_the_picture_upright() -> None:
    series, motion = make_series(90.0)
    left, _ = stereo_pair(series, motion, 0, PIXEL, (1, 0))
    upper, lower = dots_of(left)
    assert upper[0] < lower[0]  # as in the views: the first dot is up and left


def test_nothing_imaged_is_black() -> None:
    series, motion = make_series(90.0)
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, :30] = False
    masked = replace(series, views=tuple(replace(v, mask=mask, image=v.image + 50) for v in series.views))
    left, right = stereo_pair(masked, motion, 0, PIXEL, (1, 0))
    assert (left[:, :28] == 0).all()
    assert (right[:, :28] == 0).all()
