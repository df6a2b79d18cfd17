"""Rotations and cameras: round trips over the whole range of angles."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from semscape.geometry.cameras import camera_matrices, cameras_of
from semscape.geometry.rotations import axis_rotation, roll_rotation, tilted_cam_from_world, wrap_axis_angle
from semscape.types import Motion

angles = st.floats(-np.pi, np.pi)
tilts = st.floats(-1.3, 1.3)


@given(angles, tilts, angles)
def test_rotations_are_rotations(axis: float, tilt: float, roll: float) -> None:
    for rotation in (axis_rotation(axis, tilt), roll_rotation(roll), tilted_cam_from_world(axis, tilt, roll)):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) > 0


@given(angles, tilts, tilts)
def test_tilts_about_one_axis_add(axis: float, tilt1: float, tilt2: float) -> None:
    together = axis_rotation(axis, tilt1) @ axis_rotation(axis, tilt2)
    np.testing.assert_allclose(together, axis_rotation(axis, tilt1 + tilt2), atol=1e-12)


@given(angles, tilts)
def test_tilting_back_undoes_a_tilt(axis: float, tilt: float) -> None:
    np.testing.assert_allclose(axis_rotation(axis, tilt) @ axis_rotation(axis, -tilt), np.eye(3), atol=1e-12)


@given(angles, tilts)
def test_the_angle_of_a_tilt_is_the_tilt(axis: float, tilt: float) -> None:
    cosine = (np.trace(axis_rotation(axis, tilt)) - 1) / 2
    np.testing.assert_allclose(np.arccos(np.clip(cosine, -1, 1)), abs(tilt), atol=1e-6)


@given(st.floats(-20, 20), tilts)
def test_wrapping_the_axis_changes_no_rotation(axis: float, tilt: float) -> None:
    wrapped, flipped = wrap_axis_angle(axis)
    assert -np.pi / 4 - 1e-9 <= wrapped <= 3 * np.pi / 4 + 1e-9
    np.testing.assert_allclose(axis_rotation(axis, tilt), axis_rotation(wrapped, -tilt if flipped else tilt), atol=1e-9)


@given(angles)
def test_arrays_and_scalars_agree(axis: float) -> None:
    tilt, roll = np.array([-0.3, 0.0, 0.2]), np.array([0.1, -0.1, 0.0])
    stacked = tilted_cam_from_world(axis, tilt, roll)
    for i in range(3):
        np.testing.assert_allclose(stacked[i], tilted_cam_from_world(axis, tilt[i], roll[i]), atol=1e-15)


@given(angles, tilts, st.floats(-0.2, 0.2), st.floats(0.5, 2), st.floats(-0.01, 0.01))
def test_a_camera_is_its_motion(axis: float, tilt: float, roll: float, scale: float, anisotropy: float) -> None:
    motion = Motion(
        axis, np.array([tilt]), np.array([roll]), np.array([scale]), np.array([anisotropy]), np.array([[3.0, 4.0]])
    )
    points = np.random.default_rng(0).normal(0, 10, (20, 3))
    (camera,) = cameras_of(motion)
    stretch = np.diag([1 + anisotropy / 2, 1 - anisotropy / 2])
    expected = points @ (stretch * scale @ tilted_cam_from_world(axis, tilt, roll)[:2]).T + (3.0, 4.0)
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-9)
    assert camera.jacobian(points).shape == (20, 2, 3)
    step = camera.project(points + np.array([0, 0, 1e-3])) - camera.project(points)
    np.testing.assert_allclose(camera.jacobian(points)[:, :, 2], step / 1e-3, atol=1e-8)
    np.testing.assert_allclose(camera_matrices(motion)[0], camera.matrix)


def test_a_positive_roll_turns_x_towards_y() -> None:
    np.testing.assert_allclose(roll_rotation(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
