"""Heights and rotations against a truth that is made up, so that every error is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semscape.errors import BadInputError
from semscape.evaluate.height_errors import height_error, height_figures, true_units
from semscape.evaluate.motion_errors import geodesic_rad, rotation_errors_rad, tilt_figures
from semscape.evaluate.run import evaluate, true_surface
from semscape.types import HeightMap, Motion, SimulationTruth

PIXEL = 0.2
SHAPE = (60, 80)


def motion(tilts_deg: tuple[float, ...] = (-6.0, 0.0, 6.0)) -> Motion:
    zero = np.zeros(len(tilts_deg))
    centre = np.broadcast_to([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2], (len(tilts_deg), 2))
    return Motion(np.pi / 2, np.deg2rad(tilts_deg), zero, zero + 1 / PIXEL, zero, centre)


def truth(tilts_deg: tuple[float, ...] = (-6.0, 0.0, 6.0)) -> SimulationTruth:
    rows, cols = np.indices(SHAPE)
    x, y = (cols - (SHAPE[1] - 1) / 2) * PIXEL, -(rows - (SHAPE[0] - 1) / 2) * PIXEL
    height = np.sin(0.9 * x) * np.cos(0.7 * y)
    slope_x, slope_y = 0.9 * np.cos(0.9 * x) * np.cos(0.7 * y), -0.7 * np.sin(0.9 * x) * np.sin(0.7 * y)
    normals = np.stack([-slope_x, -slope_y, np.ones(SHAPE)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    grid = np.diag([PIXEL, -PIXEL, 1.0, 1.0])
    grid[:2, 3] = -PIXEL * (SHAPE[1] - 1) / 2, PIXEL * (SHAPE[0] - 1) / 2
    visible = np.ones((len(tilts_deg), *SHAPE), dtype=bool)
    return SimulationTruth(motion(tilts_deg), np.deg2rad(tilts_deg), PIXEL, height, normals, visible, grid, 0)


def found(change, **also) -> HeightMap:
    true = truth()
    rows, cols = np.indices(SHAPE)
    height = change(true.height_um.copy(), cols, rows)
    return replace(
        HeightMap(
            height_um=height,
            uncertainty_um=np.full(SHAPE, 0.05),
            n_views=np.full(SHAPE, 3, np.uint8),
            texture=np.zeros(SHAPE, np.float32),
            pixel_size_um=PIXEL,
            world_from_grid=true.world_from_grid,
            length_unit="um",
        ),
        **also,
    )


def figures(height_map: HeightMap, true: SimulationTruth | None = None) -> dict:
    true = truth() if true is None else true
    return height_figures(height_map, height_error(height_map, true.motion, 1, true), true_units(height_map, true))


def test_the_truth_itself_has_no_error() -> None:
    perfect = figures(found(lambda z, c, r: z))
    assert perfect["rmse_um"] < 1e-9
    assert perfect["height_scale_error_percent"] == pytest.approx(0, abs=1e-9)
    assert perfect["completeness"] == perfect["completeness_1px"] == 1
    assert perfect["within_1_sigma"] == 1
    assert perfect["normal_angle_median_deg"] < 0.5  # central differences of a sine


def test_origin_and_lean_are_free_but_nothing_else() -> None:
    assert figures(found(lambda z, c, r: z + 3.0))["rmse_um"] < 1e-6
    # The camera at zero tilt sees every height at its own pixel: a lean of the heights is a plane, and no more.
    assert figures(found(lambda z, c, r: z + 0.02 * c - 0.01 * r))["rmse_um"] < 1e-6


def test_a_wave_of_known_size_has_its_size_in_every_unit() -> None:
    size = 0.3
    wavy = figures(found(lambda z, c, r: z + size * np.where((c + r) % 2 == 0, 1.0, -1.0)))
    relief = np.ptp(truth().height_um)
    for name in ("median_abs_error", "rmse", "p95_abs_error"):
        assert wavy[f"{name}_um"] == pytest.approx(size, rel=0.01), name
        assert wavy[f"{name}_px"] == pytest.approx(size / PIXEL, rel=0.01), name
        assert wavy[f"{name}_percent_of_relief"] == pytest.approx(100 * size / relief, rel=0.01), name
    assert wavy["completeness_1px"] == 0  # 0.3 um is 1.5 px
    assert wavy["within_1_sigma"] == 0


def test_a_height_scale_is_told_apart_from_shape() -> None:
    scaled = figures(found(lambda z, c, r: 1.04 * z))
    assert scaled["height_scale_error_percent"] == pytest.approx(4.0, abs=1e-3)
    assert scaled["shape_rmse_um"] < 1e-6
    assert scaled["rmse_um"] == pytest.approx(0.04 * np.std(truth().height_um), rel=0.02)


def test_a_hole_is_incomplete_and_false_heights_are_no_lean() -> None:
    def spoil(z: np.ndarray, c: np.ndarray, r: np.ndarray) -> np.ndarray:
        z[:15] = np.nan
        z[50:, :20] += 8.0
        return z

    spoilt = figures(found(spoil))
    assert spoilt["completeness"] == pytest.approx(0.75)
    assert spoilt["median_abs_error_um"] < 1e-6
    assert spoilt["completeness_1px"] == pytest.approx(0.75 - 200 / 4800, abs=1e-4)


def test_points_that_the_reference_view_does_not_see_are_not_missing() -> None:
    true = truth()
    visible = true.visible.copy()
    visible[1, :15] = False

    def cut(z: np.ndarray, c: np.ndarray, r: np.ndarray) -> np.ndarray:
        z[:15] = np.nan
        return z

    assert figures(found(cut), replace(true, visible=visible))["completeness_1px"] == 1


def test_too_little_in_common_is_refused() -> None:
    with pytest.raises(ValueError, match="only 0 points"):
        figures(found(lambda z, c, r: np.full_like(z, np.nan)))


def test_a_known_rotation_is_its_angle() -> None:
    turns = Rotation.from_rotvec(np.deg2rad([[0, 0, 3.0], [4.0, 0, 0], [0, -170.0, 0]])).as_matrix()
    np.testing.assert_allclose(np.rad2deg(geodesic_rad(turns, np.eye(3))), [3, 4, 170], atol=1e-9)


def test_a_common_turn_is_an_error_in_the_world_but_not_between_views() -> None:
    true, off = motion(), replace(motion(), tilt_rad=motion().tilt_rad + np.deg2rad(0.5))
    world, relative = rotation_errors_rad(off, 1, true)
    np.testing.assert_allclose(np.rad2deg(world), 0.5, atol=1e-9)
    np.testing.assert_allclose(relative, 0, atol=1e-9)


def test_tilt_and_roll_errors_are_told() -> None:
    true = truth()
    off = replace(
        true.motion, tilt_rad=true.motion.tilt_rad + np.deg2rad([0.3, 0, 0]), roll_rad=np.deg2rad([0, 0, 0.4])
    )
    told = tilt_figures(off, 1, true)
    assert told["tilt_error_deg"] == pytest.approx([0.3, 0, 0], abs=1e-6)
    assert told["relative_rotation_error_deg"] == pytest.approx([0.3, 0, 0.4], abs=1e-6)
    assert told["relative_rotation_rms_error_deg"] == pytest.approx(np.sqrt((0.3**2 + 0.4**2) / 2), abs=1e-4)
    assert told["stage_tilt_rms_error_deg"] == 0
    # Tilts spread by 5 % too little make all heights 5 % too large, to first order.
    narrow = replace(true.motion, tilt_rad=true.motion.tilt_rad / 1.05 + 0.01)
    assert tilt_figures(narrow, 1, true)["height_scale_error_of_tilts_percent"] == pytest.approx(5)
    level = replace(true.motion, tilt_rad=0 * true.motion.tilt_rad)
    assert np.isnan(tilt_figures(level, 1, true)["height_scale_error_of_tilts_percent"])


def test_the_surface_figures_of_a_whole_result() -> None:
    told = evaluate(found(lambda z, c, r: z + 1.0), motion(), 1, truth()).figures
    assert told["surface"]["rigid"]["rmse_um"] < 1e-3
    assert told["surface"]["similarity"]["scale"] == pytest.approx(1.0, abs=1e-4)
    assert told["surface"]["rigid"]["completeness_1px"] == 1
    # As the files are: 1 um above. The nearest point of a slope is closer than the one below.
    assert 0.6 < told["surface"]["none"]["median_um"] < 1.0
    assert told["heights"]["rmse_um"] < 1e-6


def test_what_one_view_alone_sees_does_not_count() -> None:
    true = truth()
    visible = true.visible.copy()
    visible[:2, :, :40] = False
    surface = true_surface(replace(true, visible=visible))
    assert surface.area[surface.counted].sum() / surface.area.sum() == pytest.approx(0.5, abs=0.02)


def test_a_result_in_px_is_refused() -> None:
    with pytest.raises(BadInputError, match="--pixel-size-um"):
        evaluate(found(lambda z, c, r: z, length_unit="px"), motion(), 1, truth())
