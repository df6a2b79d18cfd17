"""Meshes under the beam, against closed forms and against a search through all triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from semscape.errors import BadInputError
from semscape.simulate import PRESETS, MeshSpecimen, fit_pixel_size, simulate, specimen_from_surface
from semscape.simulate.bvh import build_hierarchy, first_hits
from semscape.simulate.mesh import refine, smooth_between_creases
from semscape.simulate.surface import SKY, THINNESS, MeshSurface
from semscape.types import HeightMap, SurfaceMesh

FLAT = replace(
    PRESETS["ideal"],
    width_px=96,
    height_px=96,
    texture=0.0,
    texture_bump=0.0,
    detector_asymmetry=0.0,
    cavity=0.0,
    edge_gain=0.0,
)


def sphere(radius: float, subdivisions: int = 5) -> MeshSpecimen:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return MeshSpecimen("ball", np.asarray(ball.vertices), np.asarray(ball.faces))


def squares(*places: tuple[float, float, float]) -> MeshSpecimen:
    corner = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
    vertices = np.vstack([corner + place for place in places])
    faces = np.vstack([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(len(places))])
    return MeshSpecimen("squares", vertices, faces)


def centroid(image: np.ndarray, part: np.ndarray) -> np.ndarray:
    lit = np.where(part, image - image.min(), 0.0)
    rows, cols = np.indices(image.shape)
    return np.array([(lit * cols).sum(), (lit * rows).sum()]) / lit.sum()


def test_first_hits_are_those_of_a_search_through_all_triangles() -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (300, 1, 3)) + 0.3 * rng.standard_normal((300, 3, 3))
    tree = build_hierarchy(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3))
    origins = rng.uniform(-1, 1, (200, 3)) + np.array([0, 0, 5])
    directions = rng.standard_normal((200, 3)) * 0.2 + np.array([0, 0, -1])
    directions[:20] = [0, 0, -1]  # along an axis: a box's side divides by zero
    distance, face, weights = first_hits(tree, origins, directions, 0.0, 100.0)
    for n in range(200):
        # o + t d = a + v (b - a) + w (c - a), solved as it stands for every triangle
        system = np.stack(
            [
                np.broadcast_to(-directions[n], (300, 3)),
                corners[:, 1] - corners[:, 0],
                corners[:, 2] - corners[:, 0],
            ],
            axis=-1,
        )
        t, v, w = np.linalg.solve(system, (origins[n] - corners[:, 0])[..., None])[..., 0].T
        t = np.where((v >= 0) & (w >= 0) & (v + w <= 1) & (t >= 0), t, np.inf)
        assert distance[n] == pytest.approx(t.min())
        if np.isfinite(t.min()):
            assert face[n] == t.argmin()
            np.testing.assert_allclose(weights[n], [v[face[n]], w[face[n]]], atol=1e-9)
    assert 0.3 < np.isfinite(distance).mean() < 1
    reversed_, *_ = first_hits(tree, origins + 10 * directions, -directions, 0.0, 100.0)
    assert (np.isfinite(reversed_) == np.isfinite(distance)).all()  # the far side of the same triangles


def test_cast_meets_a_sphere_where_the_beam_and_the_sphere_do() -> None:
    radius = 3.0
    surface = MeshSurface(sphere(radius), FLAT)
    rng = np.random.default_rng(1)
    direction = np.array([[0.6, 0.0, -0.8]])
    across = rng.uniform(-2.5, 2.5, (500, 2))
    points = across[:, :1] * [[0.8, 0.0, 0.6]] + across[:, 1:] * [[0.0, 1.0, 0.0]]
    position, place = surface.cast(points, direction)
    inside = radius**2 - (across**2).sum(axis=1)
    met = inside > 0.05
    expected = points[met] - np.sqrt(inside[met])[:, None] * direction
    # Flat triangles lie below the sphere by at most edge^2 / 8 r, and a slanting beam finds that later.
    edge = 0.04 * radius
    assert np.abs(np.linalg.norm(position[met], axis=1) - radius).max() < edge**2 / (8 * radius) * 1.5
    np.testing.assert_allclose(position[met], expected, atol=0.02)
    normals = surface.normals(place[met])
    np.testing.assert_allclose(normals, expected / radius, atol=0.01)
    assert np.isnan(position[inside < -0.05]).all()


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, -60.0])
def test_outline_of_a_whole_sphere_is_the_same_circle_at_every_tilt(tilt_deg: float) -> None:
    radius, height = 3.0, 1.5
    ball = sphere(radius)
    raised = MeshSpecimen("ball", ball.vertices_um + np.array([0, 0, height]), ball.faces)
    series, truth = simulate(raised, replace(FLAT, tilts_deg=(tilt_deg,), samples=3))
    image = series.views[0].image
    seen = image > image.min()  # the empty background is the darkest
    assert seen.sum() == pytest.approx(np.pi * (radius / 0.1) ** 2, rel=0.03)
    rows, cols = np.nonzero(seen)
    middle = 47.5 + height * np.sin(np.deg2rad(tilt_deg)) / 0.1
    assert np.mean(cols) == pytest.approx(middle, abs=0.2)
    assert np.mean(rows) == pytest.approx(47.5, abs=0.2)
    assert np.nanmax(truth.height_um) == pytest.approx(radius + height, abs=0.01)
    assert np.isfinite(truth.height_um).sum() == pytest.approx(np.pi * (radius / 0.1) ** 2, rel=0.02)


def test_yield_of_a_sphere_is_the_secant_of_the_angle_to_the_beam() -> None:
    options = replace(FLAT, tilts_deg=(20.0,), yield_saturation=0.3, samples=4)
    image = simulate(sphere(3.5), options)[0].views[0].image
    # Grey levels are a + b * yield: two rings fix a and b, the others must follow.
    rows, cols = np.indices(image.shape)
    sine = np.hypot(cols - 47.5, rows - 47.5) * 0.1 / 3.5
    secant = 1.3 / (np.sqrt(1 - np.minimum(sine, 1) ** 2) + 0.3)
    inner = sine < 0.9
    slope, offset = np.polyfit(secant[inner], image[inner], 1)
    assert slope > 10
    assert np.abs(image - offset - slope * secant)[inner].max() < 2.5


@pytest.mark.parametrize("distance", [150.0, 60.0])
def test_perspective_magnifies_what_is_nearer(distance: float) -> None:
    height = 9.0
    options = replace(FLAT, tilts_deg=(0.0,), working_distance_um=distance, width_px=256, height_px=64, samples=4)
    series, truth = simulate(squares((-4.0, 0.0, height), (4.0, 0.0, height), (0.0, 0.0, 0.0)), options)
    image = series.views[0].image
    cols = np.indices(image.shape)[1]
    left, middle, right = (centroid(image, part)[0] for part in (cols < 100, (cols > 115) & (cols < 140), cols > 150))
    assert middle == pytest.approx(127.5, abs=0.05)
    assert right - left == pytest.approx(80 * distance / (distance - height), abs=0.15)
    # All three are seen from above, although the outer ones are seen from the side.
    assert truth.visible[0][np.isfinite(truth.height_um)].all()
    assert truth.working_distance_um == distance


def test_skew_shifts_x_with_y() -> None:
    options = replace(FLAT, tilts_deg=(0.0,), skew=0.05)
    series, truth = simulate(squares((0.0, 4.0, 0.0), (0.0, -4.0, 0.0)), options, rng=3)
    image = series.views[0].image
    rows = np.indices(image.shape)[0]
    upper, lower = centroid(image, rows < 48), centroid(image, rows >= 48)
    assert abs(truth.skew[0]) > 0.005
    np.testing.assert_allclose(lower - upper, [80 * truth.skew[0], 80], atol=0.05)


def test_far_side_of_a_mesh_shows_at_large_tilts_alone() -> None:
    """A table top over a plate: a height map would have walls under the top."""
    top = np.array([[-2.0, -2, 2], [2, -2, 2], [2, 2, 2], [-2, 2, 2]])
    plate = np.array([[-8.0, -8, 0], [8, -8, 0], [8, 8, 0], [-8, 8, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    table = MeshSpecimen("table", np.vstack([top, plate]), np.vstack([faces, faces + 4]))
    series, truth = simulate(table, replace(FLAT, tilts_deg=(45.0,), texture=0.2))
    # Beams at 45 deg reach the plate under the top from its edge on; at zero tilt that place is hidden.
    hidden_um = (~truth.visible[0] & (truth.height_um < 1)).sum() * 0.1**2
    assert hidden_um == pytest.approx(2.0 * 4.0, rel=0.1)
    assert (series.views[0].image > 0).all()


def test_creases_divide_normals_and_gentle_edges_do_not() -> None:
    cube = trimesh.creation.box(extents=(4, 4, 4))
    vertices, normals, faces = smooth_between_creases(np.asarray(cube.vertices), np.asarray(cube.faces))
    assert len(vertices) == 24
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1)
    ball = sphere(1.0, 3)
    vertices, normals, faces = smooth_between_creases(ball.vertices_um, ball.faces)
    assert len(vertices) == len(ball.vertices_um)
    np.testing.assert_allclose(normals, vertices, atol=0.02)
    fine, _, smaller = refine(vertices, normals, faces, 0.05)
    edges = fine[np.roll(smaller, -1, axis=1)] - fine[smaller]
    assert np.linalg.norm(edges, axis=2).max() <= 0.05
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    whole = vertices[np.roll(faces, -1, axis=1)] - vertices[faces]
    assert area == pytest.approx(np.linalg.norm(np.cross(whole[:, 0], whole[:, 1]), axis=1).sum())


def test_edges_are_thin_and_corners_of_a_room_see_half_the_sky() -> None:
    cube = trimesh.creation.box(extents=(6, 6, 6))
    floor = trimesh.creation.box(
        extents=(16, 16, 1), transform=trimesh.transformations.translation_matrix([0, 0, -3.5])
    )
    both = trimesh.util.concatenate([cube, floor])
    specimen = MeshSpecimen("cube", np.asarray(both.vertices), np.asarray(both.faces))

    def surface_of() -> MeshSurface:
        return MeshSurface(specimen, replace(FLAT, edge_px=10.0))

    surface = surface_of()
    x = np.array([0.0, 2.3, 2.9, 3.15, 7.0])
    points = np.column_stack([x, np.zeros(5), np.zeros(5)])
    position, place = surface.cast(points, np.array([[0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(position[:, 2], [3, 3, 3, -3, -3], atol=1e-6)
    thinness, sky = surface.attributes(place)[:, [THINNESS, SKY]].T
    assert thinness[0] == pytest.approx(0, abs=0.02)
    assert thinness[0] < thinness[1] < 0.2 < thinness[2] < 0.6  # at the edge itself half of all directions lead out
    np.testing.assert_allclose(sky[:3], 1.0, atol=0.03)
    assert 0.2 < sky[3] < 0.6  # the wall, 6 um high, hides nearly half of the sky
    assert sky[4] > 0.85
    # Places are worked out where beams land; which landed before, or with them, changes nothing.
    one_by_one = np.vstack([surface_of().attributes(place[n : n + 1]) for n in reversed(range(5))])[::-1]
    np.testing.assert_array_equal(one_by_one, surface.attributes(place))


def test_surfaces_of_ones_own_stand_in_the_middle_and_fill_the_image() -> None:
    vertices = np.array([[10.0, 0, 5], [30, 0, 5], [30, 8, 9], [10, 8, 9]])
    mesh = SurfaceMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros((4, 3), dtype=np.uint8), "um")
    specimen = specimen_from_surface("ramp.stl", mesh)
    options = fit_pixel_size(replace(FLAT, tilts_deg=(0.0,)), specimen)
    assert options.pixel_size_um == pytest.approx(20 / 96 / 0.9)
    _, truth = simulate(specimen, options)
    seen = np.isfinite(truth.height_um)
    assert seen.mean() == pytest.approx(0.9 * 0.9 * 0.4, rel=0.05)
    assert np.nanmean(truth.height_um) == pytest.approx(0, abs=0.05)
    assert truth.settings["specimen"] == "ramp.stl"
    with pytest.raises(BadInputError, match="give another pixel size"):
        simulate(MeshSpecimen("far", vertices + 1e4, mesh.faces), options)
    with pytest.raises(BadInputError, match="needs lengths in um"):
        specimen_from_surface("ramp", replace(mesh, length_unit="px"))


def test_holes_of_a_height_map_stay_holes() -> None:
    height = np.zeros((200, 300))
    height[:100, :150] = np.nan
    unknown = np.full(height.shape, np.nan)
    surface = HeightMap(
        height, unknown, np.ones(height.shape, dtype=np.uint8), unknown.astype(np.float32), 0.1, np.eye(4), "um"
    )
    specimen = specimen_from_surface("map.npz", surface)
    options = fit_pixel_size(replace(FLAT, texture=0.2, tilts_deg=(-30.0, 0.0)), specimen)
    assert options.pixel_size_um == pytest.approx(19.9 / 96 / 1.1)
    series, truth = simulate(specimen, options)
    assert np.isnan(truth.height_um[:47, :47]).all()
    assert (truth.height_um[49:, :] == 0).all()
    assert not truth.visible[:, :47, :47].any()
    assert truth.visible[1, 49:].all()
    dark = series.views[1].image[:46, :46]
    assert np.ptp(dark) == 0
    assert (series.views[1].image[50:] > dark[0, 0]).all()
    np.testing.assert_allclose(truth.normals[60, 60], [0, 0, 1])
