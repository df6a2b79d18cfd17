"""Camera, focus and backscatter segments against closed forms written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.simulate import PRESETS, SimulationOptions, Specimen, acquire, simulate
from semscape.simulate.camera import ScanCamera
from semscape.simulate.cast import block_tops, cast_rays
from semscape.simulate.faults import blur_beam
from semscape.simulate.render import Scene, render_signal

BARE = replace(
    PRESETS["ideal"],
    tilts_deg=(0.0,),
    width_px=64,
    height_px=48,
    texture=0.0,
    texture_bump=0.0,
    cavity=0.0,
    edge_gain=0.0,
    detector_asymmetry=0.0,
)


def plane(slope_deg: float, azimuth_deg: float) -> Specimen:
    """A plane whose normal leans by the slope towards the azimuth."""
    at = (np.arange(301) - 150) * 0.05
    along = at[None, :] * np.cos(np.deg2rad(azimuth_deg)) - at[:, None] * np.sin(np.deg2rad(azimuth_deg))
    return Specimen("slope", (-np.tan(np.deg2rad(slope_deg)) * along).astype(np.float32), 0.05, 0)


def level_signal(specimen: Specimen, options: SimulationOptions) -> np.ndarray:
    camera = ScanCamera(np.diag([1.0, -1.0, -1.0]), 10 * np.eye(2), np.array([31.5, 23.5]))
    signal, _ = render_signal(Scene(specimen, options), camera, (np.pi / 2, 0.0), np.zeros((48, 2)))
    assert np.ptp(signal[:, 4:-4, 4:-4], axis=(1, 2)).max() < 1e-3
    return signal[:, 24, 32]


@pytest.mark.parametrize(("slope_deg", "azimuth_deg"), [(0.0, 0.0), (20.0, 45.0), (25.0, 160.0)])
@pytest.mark.parametrize(("detector", "first_deg"), [("bse-3", 90.0), ("bse-4", 45.0)])
def test_backscatter_segments_share_the_yield_by_the_cosine(
    slope_deg: float, azimuth_deg: float, detector: str, first_deg: float
) -> None:
    count, elevation = int(detector[-1]), np.deg2rad(40.0)
    options = replace(BARE, detector=detector, segment_elevation_deg=40.0, atomic_number=25.0)
    found = level_signal(plane(slope_deg, azimuth_deg), options)
    slope = np.deg2rad(slope_deg)
    eta = ((1 + np.cos(slope)) / 2) ** (-9 / 5)
    for k in range(count):
        middle = np.deg2rad(first_deg + 360 * k / count)
        over = middle + np.deg2rad(360 / count) * (np.arange(2000) + 0.5 - 1000) / 2000
        cosine = np.sin(slope) * np.cos(elevation) * np.cos(over - np.deg2rad(azimuth_deg))
        cosine = cosine + np.cos(slope) * np.sin(elevation)
        assert found[k] == pytest.approx(eta * cosine.mean() / np.sin(elevation), rel=1e-4)


def test_a_wall_keeps_a_segment_in_the_dark_for_its_height_over_the_tangent() -> None:
    x = (np.arange(401) - 200) * 0.05
    height = np.broadcast_to(np.where(x < 0, 1.5, 0.0), (401, 401)).astype(np.float32)
    options = replace(BARE, detector="bse-4", segment_elevation_deg=40.0, cavity=1.0, scan_rotation_deg=45.0)
    camera = ScanCamera(np.diag([1.0, -1.0, -1.0]), 10 * np.eye(2), np.array([31.5, 23.5]))
    signal, _ = render_signal(
        Scene(Specimen("step", height.copy(), 0.05, 0), options), camera, (np.pi / 2, 0.0), np.zeros((48, 2))
    )
    # Turned by 45 deg the segments stand at 90, 180, 270 and 0 deg: the second behind the wall.
    row = signal[:, 24]
    dark_px = (row[1, 32:] == 0).sum()
    assert dark_px == pytest.approx(1.5 / np.tan(np.deg2rad(40.0)) / 0.1, abs=1.5)
    assert (row[3, 34:] > 0.99).all()


def test_segments_make_up_the_series_and_count_a_share_of_the_electrons_each() -> None:
    options = replace(BARE, detector="bse-4", dose=200.0, height_px=200, width_px=200)
    flat = Specimen("flat", np.zeros((601, 601), dtype=np.float32), 0.05, 0)
    acquisition = acquire(flat, options)
    assert [part.names[0] for part in acquisition.segments] == [f"view_00_+00.00deg_{name}.tif" for name in "ABCD"]
    whole = acquisition.series.views[0].image
    each = [part.views[0].image for part in acquisition.segments]
    np.testing.assert_allclose(np.mean(each, axis=0), whole, atol=1.0)
    variances = [image.var() - 1 / 12 for image in each]  # rounding to whole grey levels adds 1 / 12
    assert np.mean(variances) / (whole.var() - 1 / 12) == pytest.approx(4, rel=0.05)
    assert abs(np.corrcoef(each[0].ravel(), each[1].ravel())[0, 1]) < 0.02
    told = acquisition.truth.settings["segments"]
    assert [part["azimuth_deg"] for part in told] == [45.0, 135.0, 225.0, 315.0]


def test_scan_rotation_turns_the_picture_of_everything_in_the_lab() -> None:
    """An axis at 20 deg scanned with 70 deg shows as one at 90 deg, and so does the detector."""
    options = replace(PRESETS["nominal"], width_px=64, height_px=64, tilts_deg=(-10.0, 10.0))
    turned, truth = simulate(
        "spheres", replace(options, axis_deg=20.0, scan_rotation_deg=70.0, detector_azimuth_deg=5.0)
    )
    same, _ = simulate("spheres", replace(options, axis_deg=90.0, detector_azimuth_deg=75.0))
    for one, two in zip(turned.views, same.views, strict=True):
        np.testing.assert_array_equal(one.image, two.image)
        assert np.rad2deg(one.metadata.scan_rotation_rad) == pytest.approx(70.0)
        assert two.metadata.scan_rotation_rad == 0
    assert truth.motion.axis_angle_rad == pytest.approx(np.pi / 2)


def test_half_a_turn_of_the_scan_swaps_the_sense_of_the_tilts() -> None:
    options = replace(PRESETS["ideal"], width_px=64, height_px=64, tilts_deg=(-10.0, 4.0), stage_error_deg=0.1)
    series, truth = simulate("spheres", replace(options, scan_rotation_deg=180.0))
    _, plain = simulate("spheres", options)
    # The readings are the stage's; the motion is told about the axis as the image shows it.
    np.testing.assert_allclose(np.rad2deg(series.tilt_rad), [-10, 4])
    assert truth.motion.axis_angle_rad == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(truth.motion.tilt_rad, -plain.motion.tilt_rad)
    np.testing.assert_allclose(np.rad2deg(truth.stage_tilt_rad), [10, -4])


def test_defocus_widens_the_beam_with_the_distance_from_the_focal_plane() -> None:
    point = np.zeros((81, 81))
    point[40, 40] = 1.0
    depth = np.full(point.shape, -200.0)
    options = replace(BARE, blur_px=1.2, defocus=0.008)
    x = np.arange(81) - 40
    blurred = blur_beam(point, depth, options)
    assert (blurred.sum(axis=0) * x**2).sum() == pytest.approx(1.2**2 + 1.6**2, rel=0.02)
    # Over a slope each place has its own beam: two points of one image.
    point[40, 20] = point[40, 60] = 1.0
    depth = np.broadcast_to(np.where(x < 0, 0.0, 200.0), point.shape)
    blurred = blur_beam(point, depth, options)
    for at, variance in ((20, 1.2**2), (60, 1.2**2 + 1.6**2)):
        part = blurred[:, at - 8 : at + 9].sum(axis=1)
        assert (part * x**2).sum() / part.sum() == pytest.approx(variance, rel=0.03)


def test_focus_follows_the_surface_as_it_tilts() -> None:
    specimen = Specimen("flat", np.zeros((601, 601), dtype=np.float32), 0.05, 0)
    angle = np.deg2rad(40.0)
    rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, -1.0, 0], [np.sin(angle), 0, -np.cos(angle)]])
    camera = ScanCamera(rotation, 10 * np.eye(2), np.array([31.5, 23.5]))
    _, depth = render_signal(Scene(specimen, BARE), camera, (np.pi / 2, float(angle)), np.zeros((48, 2)))
    # x' = X cos, depth = X sin.
    np.testing.assert_allclose(depth[10], (np.arange(64) - 31.5) * 0.1 * np.tan(angle), atol=1e-6)


@pytest.mark.parametrize("distance", [np.inf, 50.0])
def test_rays_pass_through_what_their_pixels_show(distance: float) -> None:
    rng = np.random.default_rng(2)
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    camera = ScanCamera(rotation, np.array([[9.0, 0.5], [0.2, 11.0]]), np.array([3.0, 4.0]), distance)
    xy = rng.uniform(0, 60, (50, 2))
    points, beam = camera.rays(xy)
    np.testing.assert_allclose(np.linalg.norm(beam, axis=1), 1)
    for along in (-7.0, 0.0, 12.0):
        np.testing.assert_allclose(camera.project(points + along * beam), xy, atol=1e-9)


@pytest.mark.parametrize("lean", [0.1, 3.0, -8.0])
def test_cast_over_many_blocks_finds_what_a_march_in_small_steps_finds(lean: float) -> None:
    rng = np.random.default_rng(3)
    height = (4.0 * rng.random((75, 90))).astype(np.float32)
    height[10:30, 40:60] += 12.0
    origin = np.column_stack([rng.uniform(10, 80, 40), rng.uniform(10, 65, 40)])
    slope = np.array([[lean, -0.4 * lean]])
    hit = np.empty((40, 3))
    cast_rays(height, block_tops(height), origin, slope, float(height.max()), float(height.min()), hit)
    z = np.linspace(float(height.max()), 0.0, 50_001)
    for (col, row), found in zip(origin, hit, strict=True):
        x, y = col + slope[0, 0] * z, row + slope[0, 1] * z
        inside = (x >= 0) & (y >= 0) & (x <= 89) & (y <= 74)
        ix, iy = np.clip(x.astype(int), 0, 88), np.clip(y.astype(int), 0, 73)
        fx, fy = x - ix, y - iy
        level = (1 - fy) * ((1 - fx) * height[iy, ix] + fx * height[iy, ix + 1])
        level = level + fy * ((1 - fx) * height[iy + 1, ix] + fx * height[iy + 1, ix + 1])
        below = np.flatnonzero(inside & (z <= level))
        if not len(below):
            assert np.isnan(found).all()
        elif not (below[0] > 0 and not inside[below[0] - 1]):  # a ray that enters the grid under the surface
            assert found[2] == pytest.approx(z[below[0]], abs=1e-3)
    assert np.isfinite(hit[:, 2]).mean() > 0.5


def test_absurd_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="detector must be one of se, bse-3, bse-4"):
        SimulationOptions(detector="bse-5")
    with pytest.raises(ValueError, match="twice the field of view"):
        SimulationOptions(working_distance_um=100.0)
    with pytest.raises(ValueError, match="atomic_number"):
        SimulationOptions(atomic_number=0.0)
