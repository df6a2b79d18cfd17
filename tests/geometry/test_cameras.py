"""Cameras: both through one protocol, their derivatives against finite differences, the limit of a far centre."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.geometry.cameras import Camera, PerspectiveCamera, ScaledOrthographicCamera, perspective_cameras_of
from synthetic_tracks import make_motion

MATRIX = np.random.default_rng(0).normal(0, 5, (2, 3))
POINTS = np.random.default_rng(1).normal(0, 20, (7, 3))


@pytest.mark.parametrize(
    "camera",
    [
        ScaledOrthographicCamera(MATRIX, np.array([3.0, 4.0])),
        PerspectiveCamera(MATRIX, np.array([3.0, 4.0]), np.array([1e-3, -2e-3, 4e-3]), np.array([40.0, 30.0])),
    ],
)
def test_derivatives_equal_finite_differences(camera: Camera) -> None:
    step = 1e-5
    numeric = np.stack(
        [(camera.project(POINTS + step * e) - camera.project(POINTS - step * e)) / (2 * step) for e in np.eye(3)],
        axis=2,
    )
    np.testing.assert_allclose(camera.jacobian(POINTS), numeric, atol=1e-7)


def test_what_is_nearer_looks_larger() -> None:
    motion = make_motion((0.0, 10.0), axis_deg=90.0)
    centre = motion.translation_px[0]
    camera = perspective_cameras_of(motion, 1 / 500, centre)[0]
    low, high = camera.project(np.array([[10.0, 0.0, -5.0], [10.0, 0.0, 5.0]]))
    assert np.linalg.norm(high - centre) > np.linalg.norm(low - centre)
    # Magnification goes with the inverse distance to the lens: 495 um against 505 um.
    assert np.linalg.norm(high - centre) / np.linalg.norm(low - centre) == pytest.approx(505 / 495, rel=1e-3)
