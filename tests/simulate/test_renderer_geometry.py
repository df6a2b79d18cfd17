"""The renderer against closed forms of parallel projection; no projection code of the package is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.simulate import PRESETS, SimulationOptions, Specimen, simulate
from semscape.simulate.cast import block_tops, cast_rays

PIXEL = 0.1
SIZE = 96
A_DEG = 5.0
SIN_A, COS_A, TAN_A = (float(f(np.deg2rad(A_DEG))) for f in (np.sin, np.cos, np.tan))

# Texture alone: no shading that changes with the tilt.
TEXTURE_ONLY = replace(
    PRESETS["ideal"],
    tilts_deg=(-A_DEG, A_DEG),
    width_px=SIZE,
    height_px=SIZE,
    pixel_size_um=PIXEL,
    texture=0.3,
    texture_bump=0.0,
    detector_asymmetry=0.0,
    cavity=0.0,
    edge_gain=0.0,
)


def height_field(height: np.ndarray) -> Specimen:
    return Specimen("test", np.ascontiguousarray(height, dtype=np.float32), PIXEL / 2, texture_seed=5)


def world_axes(n: int = 401) -> tuple[np.ndarray, np.ndarray]:
    x = (np.arange(n) - (n - 1) / 2) * PIXEL / 2
    return np.meshgrid(x, -x)


def images(specimen: Specimen, options: SimulationOptions) -> list[np.ndarray]:
    return [view.image for view in simulate(specimen, options)[0].views]


@pytest.mark.parametrize(("axis_deg", "moves_along"), [(90.0, 1), (0.0, 0)])
def test_parallax_of_a_raised_plane_is_2_z_sin_a_to_larger_x_or_y(axis_deg: float, moves_along: int) -> None:
    parallax_px = 12
    z = parallax_px * PIXEL / (2 * SIN_A)
    minus, plus = images(height_field(np.full((401, 401), z)), replace(TEXTURE_ONLY, axis_deg=axis_deg))
    moved = np.roll(minus, parallax_px, axis=moves_along)
    inner = (slice(parallax_px + 1, -1),) * 2
    assert np.ptp(minus) > 60
    assert np.abs(plus[inner] - moved[inner]).max() <= 1  # grey level: rounding of the position and of the value
    assert np.abs(plus[inner] - np.roll(minus, -parallax_px, axis=moves_along)[inner]).mean() > 5


def test_parallax_along_an_oblique_axis_is_perpendicular_to_it() -> None:
    # The axis at 45 degrees points up and to the right; a peak moves right and down, equally far.
    parallax_px = 8
    z = parallax_px * np.sqrt(2) * PIXEL / (2 * SIN_A)
    minus, plus = images(height_field(np.full((401, 401), z)), replace(TEXTURE_ONLY, axis_deg=45.0))
    moved = np.roll(minus, (parallax_px, parallax_px), axis=(0, 1))
    assert np.abs((plus - moved)[10:-10, 10:-10]).max() <= 1


def test_step_moves_its_upper_side_alone_and_hides_h_tan_a_of_the_ground() -> None:
    parallax_px = 12
    z = parallax_px * PIXEL / (2 * SIN_A)
    x, _ = world_axes()
    specimen = height_field(np.where(x < 0, z, 0.0))
    series, truth = simulate(specimen, TEXTURE_ONLY)
    minus, plus = (view.image for view in series.views)
    np.testing.assert_allclose(plus[1:-1, 70:-2], minus[1:-1, 70:-2], atol=1)
    np.testing.assert_allclose(plus[1:-1, 20:40], minus[1:-1, 8:28], atol=1)
    # Positive tilt about +y leans the plateau at x < 0 over the ground at x > 0, negative tilt bares the wall.
    in_middle = truth.visible[:, 10:-10, 30:75]
    hidden_px = (~in_middle).sum(axis=2).mean(axis=1)
    assert hidden_px[0] == 0
    assert hidden_px[1] == pytest.approx(z * TAN_A / PIXEL, abs=1.0)


def test_sphere_keeps_its_outline_and_moves_by_2_z_sin_a_of_its_centre() -> None:
    x, y = world_axes()
    radius = 2.5
    rest = radius**2 - x**2 - y**2
    specimen = height_field(np.where(rest > 0, radius + np.sqrt(np.maximum(rest, 0)), 0.0))
    smooth = replace(TEXTURE_ONLY, texture=0.0, tilts_deg=(-A_DEG, 0.0, A_DEG), samples=4)
    series, _ = simulate(specimen, smooth)
    minus, level, plus = (view.image for view in series.views)
    # Level ground is the darkest surface there is: the sphere and its wall are everything brighter.
    brighter = {name: image > image.min() + 2 for name, image in (("-", minus), ("0", level), ("+", plus))}
    # Of the four ground pixels at each border of the disc only a part is covered; the top of the sphere is level too.
    cols = np.flatnonzero(brighter["0"].any(axis=0))
    assert (cols[-1] - cols[0] + 1) / 2 == pytest.approx(radius / PIXEL, abs=1.0)
    # The leaning side's outline is the sphere's own: centre at height r moves by r sin a, the radius stays.
    right = np.flatnonzero(brighter["+"][SIZE // 2])[-1]
    left = np.flatnonzero(brighter["-"][SIZE // 2])[0]
    centre = (SIZE - 1) / 2
    expected = (radius + radius * SIN_A) / PIXEL
    assert right - centre == pytest.approx(expected, abs=1.0)
    assert centre - left == pytest.approx(expected, abs=1.0)
    # The darkest point faces the beam: in the image it lies over the centre (0, 0, r), whatever the tilt.
    disc = (slice(SIZE // 2 - 8, SIZE // 2 + 8), slice(SIZE // 2 - 12, SIZE // 2 + 13))
    darkest = [np.array(np.nonzero(image[disc] == image[disc].min()))[1].mean() - 12 for image in (minus, plus)]
    assert (darkest[1] - darkest[0]) * PIXEL == pytest.approx(2 * radius * SIN_A, abs=2 * PIXEL)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, -40.0, -70.0])
def test_cast_meets_a_slope_where_the_line_and_the_plane_do(tilt_deg: float) -> None:
    # Plane z = 0.3 col + 0.1 row - 10 over unit cells; the rays lean along the columns and half along the rows.
    col, row = np.meshgrid(np.arange(60.0), np.arange(50.0))
    height = (0.3 * col + 0.1 * row - 10).astype(np.float32)
    lean = np.tan(np.deg2rad(tilt_deg)) * np.array([[1.0, 0.5]])
    origin = np.array([[30.0, 20.0], [25.5, 30.25], [28.0, 22.75]])
    hit = np.empty((3, 3))
    cast_rays(height, block_tops(height), origin, lean, float(height.max()), float(height.min()), hit)
    z = (origin @ [0.3, 0.1] - 10) / (1 - lean[0] @ [0.3, 0.1])
    np.testing.assert_allclose(hit[:, 2], z, atol=2e-5)
    np.testing.assert_allclose(hit[:, :2], origin + z[:, None] * lean, atol=1e-4)


def test_cast_finds_the_first_of_two_walls_and_misses_off_the_grid() -> None:
    height = np.zeros((10, 40), dtype=np.float32)
    height[:, [12, 25]] = 5.0  # two thin walls, as roofs over one cell on each side
    hit = np.empty((2, 3))
    # Seen from the right: the ray descends towards smaller columns and must stop at the wall at 25, not at 12.
    cast_rays(height, block_tops(height), np.array([[8.0, 5.0], [-900.0, 5.0]]), np.array([[8.0, 0.0]]), 5.0, 0.0, hit)
    # Roof between 25 and 26: z = 5 (26 - col), ray: col = 8 + 8 z.
    assert hit[0, 2] == pytest.approx(5 * 18 / 41, abs=1e-4)
    assert hit[0, 0] == pytest.approx(8 + 8 * hit[0, 2], abs=1e-4)
    assert np.isnan(hit[1]).all()


def test_scale_anisotropy_and_roll_map_the_plane_as_the_convention_says() -> None:
    # A texture-free landscape with one pyramid per known place; its darkest spot is the flat top.
    x, y = world_axes(481)
    tops = [(-3.0, 2.0), (2.5, 3.0), (1.0, -3.0)]
    height = np.zeros(x.shape)
    for u, v in tops:
        height = np.maximum(height, 1.0 - 2.0 * np.maximum(np.hypot(x - u, y - v) - 0.2, 0.0))
    options = replace(
        TEXTURE_ONLY,
        texture=0.0,
        samples=4,
        tilts_deg=(0.0,),
        roll_deg=15.0,
        scale_drift=0.08,
        anisotropy=0.08,
        shift_px=2.0,
    )
    series, truth = simulate(height_field(height), options, rng=11)
    image, motion = series.views[0].image, truth.motion
    roll, scale, k = motion.roll_rad[0], motion.scale_px_per_um[0], motion.anisotropy[0]
    assert min(abs(roll), abs(scale * PIXEL - 1), abs(k)) > 0.01
    rows, cols = np.mgrid[:SIZE, :SIZE]
    for u, v in tops:
        # Image y is down: (u, -v), turned from +x towards +y, then stretched.
        px = (1 + k / 2) * scale * (np.cos(roll) * u - np.sin(roll) * -v) + motion.translation_px[0, 0]
        py = (1 - k / 2) * scale * (np.sin(roll) * u + np.cos(roll) * -v) + motion.translation_px[0, 1]
        ring = np.hypot(cols - px, rows - py) < 9
        weight = np.where(ring & (image > image.min() + 2), 1.0, 0.0)
        assert weight.sum() > 50
        found = np.array([(weight * cols).sum(), (weight * rows).sum()]) / weight.sum()
        np.testing.assert_allclose(found, [px, py], atol=0.35)
