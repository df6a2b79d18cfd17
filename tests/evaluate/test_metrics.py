"""Metrics on shapes whose answers are known: planes, spheres, holes, turns."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from semscape.evaluate.align import Alignment, align_points, align_to_surface, identity
from semscape.evaluate.distances import Cloud, surface_figures
from semscape.evaluate.surface import closest, make_surface
from semscape.evaluate.units import Units
from semscape.geometry.triangle_tree import closest_on_triangles, make_tree

UNITS = Units(pixel_size_um=0.1, relief_um=4.0)
RNG = np.random.default_rng(5)


def sheet(height, *, side: float = 10.0, nodes: int = 61) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh of height(x, y) over a square, counter-clockwise from above."""
    x, y = np.meshgrid(np.linspace(-side / 2, side / 2, nodes), np.linspace(-side / 2, side / 2, nodes))
    index = np.arange(nodes * nodes).reshape(nodes, nodes)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel()
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([b, d, c])])
    return np.column_stack([x.ravel(), y.ravel(), np.broadcast_to(height(x, y), x.shape).ravel()]), faces


def hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sin(1.1 * x) * np.cos(0.8 * y + 0.4) + 0.15 * x + 0.05 * y**2


def sphere(radius: float) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def test_two_planes_apart_have_their_distance_as_every_length() -> None:
    truth = make_surface(*sheet(lambda x, y: 0 * x))
    figures = surface_figures(make_surface(*sheet(lambda x, y: 0 * x + 0.25)), truth, "none", UNITS)
    for name in ("rmse", "median", "p95", "chamfer", "hausdorff", "hausdorff_p95"):
        assert figures[f"{name}_um"] == pytest.approx(0.25, rel=1e-6), name
        assert figures[f"{name}_px"] == pytest.approx(2.5, rel=1e-6), name
        assert figures[f"{name}_percent_of_relief"] == pytest.approx(6.25, rel=1e-6), name
    assert figures["completeness_1px"] == 0
    assert figures["normal_angle_mean_deg"] == pytest.approx(0, abs=1e-5)


def test_a_rigid_motion_takes_the_distance_of_two_planes_away() -> None:
    truth = make_surface(*sheet(lambda x, y: 0 * x))
    figures = surface_figures(make_surface(*sheet(lambda x, y: 0 * x + 0.25)), truth, "rigid", UNITS)
    assert figures["hausdorff_um"] < 1e-6
    assert figures["shift_um"] == pytest.approx(0.25, rel=1e-5)
    assert figures["completeness_1px"] == 1


def test_a_tilted_plane_has_its_angle_as_normal_angle() -> None:
    slope = np.tan(np.deg2rad(7.0))
    truth = make_surface(*sheet(lambda x, y: 0 * x))
    figures = surface_figures(make_surface(*sheet(lambda x, y: slope * x)), truth, "none", UNITS)
    assert figures["normal_angle_mean_deg"] == pytest.approx(7.0, abs=1e-3)
    assert figures["normal_angle_median_deg"] == pytest.approx(7.0, abs=1e-3)
    # Of the distances along z, up to 5 tan 7 at the rim, a plane through the middle has a mean square of a third.
    assert figures["rmse_um"] == pytest.approx(5 * slope / np.sqrt(3), rel=1e-3)
    # Its upper and lower edges are nearest to the truth's edges: the fall of the cosine is seen at both ends.
    assert figures["hausdorff_um"] == pytest.approx(5 * slope, rel=0.01)


def test_a_scaled_sphere_is_off_by_its_scale_until_a_similarity_takes_it_away() -> None:
    truth, found = make_surface(*sphere(2.0)), make_surface(*sphere(2.2))
    rigid = surface_figures(found, truth, "rigid", UNITS)
    # The facets of both lie up to 0.001 within their spheres.
    for name in ("rmse", "median", "chamfer", "hausdorff_p95"):
        assert rigid[f"{name}_um"] == pytest.approx(0.2, abs=0.003), name
    similar = surface_figures(found, truth, "similarity", UNITS)
    assert similar["scale"] == pytest.approx(1 / 1.1, rel=1e-4)
    assert similar["hausdorff_um"] < 0.002
    assert similar["turn_deg"] < 0.2


def test_a_hole_is_missing_from_completeness_and_seen_by_hausdorff_from_the_truth() -> None:
    vertices, faces = sheet(hills)
    centre = vertices[faces].mean(axis=1)
    radius = 2.0
    inside = np.hypot(centre[:, 0], centre[:, 1]) < radius
    truth = make_surface(*sheet(lambda x, y: 0 * x))
    flat, _ = sheet(lambda x, y: 0 * x)
    figures = surface_figures(make_surface(flat, faces[~inside]), truth, "none", UNITS)
    assert figures["rmse_um"] < 1e-9  # what is there is right
    assert figures["hausdorff_um"] == pytest.approx(radius, abs=0.15)
    # Missing: the disc, but for the ring within one px of its edge.
    assert figures["completeness_1px"] == pytest.approx(1 - np.pi * (radius - 0.1) ** 2 / 100, abs=0.005)


def test_what_the_truth_does_not_count_is_not_missing() -> None:
    vertices, faces = sheet(lambda x, y: 0 * x)
    inside = np.hypot(*vertices[faces].mean(axis=1)[:, :2].T) < 2.0
    found = make_surface(vertices, faces[~inside])
    figures = surface_figures(found, make_surface(vertices, faces, ~inside), "none", UNITS)
    assert figures["completeness_1px"] == 1
    assert figures["hausdorff_um"] < 1e-9


def test_one_false_spike_moves_hausdorff_alone() -> None:
    vertices, faces = sheet(lambda x, y: 0 * x)
    truth = make_surface(vertices, faces)
    spiky = vertices.copy()
    spiky[30 * 61 + 30, 2] = 3.0
    figures = surface_figures(make_surface(spiky, faces), truth, "none", UNITS)
    assert figures["hausdorff_um"] > 1.5
    assert figures["hausdorff_p95_um"] < 1e-9
    assert figures["median_um"] < 1e-9


def test_chamfer_is_the_mean_of_both_directions() -> None:
    """A strip of a plane is right everywhere, but the truth beside it is far: |x| - 1 over 1 < |x| < 5."""
    vertices, faces = sheet(lambda x, y: 0 * x, nodes=101)
    strip = np.abs(vertices[faces].mean(axis=1)[:, 0]) < 1.0
    figures = surface_figures(make_surface(vertices, faces[strip]), make_surface(vertices, faces), "none", UNITS)
    assert figures["chamfer_um"] == pytest.approx((0 + 0.8 * 2.0) / 2, rel=0.01)
    assert figures["hausdorff_um"] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("kind", ["rigid", "similarity"])
def test_a_known_turn_and_shift_is_found(kind) -> None:
    vertices, faces = sheet(hills)
    truth = make_surface(vertices, faces)
    turn = Rotation.from_rotvec(np.deg2rad([3.0, -2.0, 4.0]))
    scale = 1.0 if kind == "rigid" else 1.05
    moved = (scale * turn.apply(vertices)) + [0.3, -0.2, 0.4]
    figures = surface_figures(make_surface(moved, faces), truth, kind, UNITS)
    assert figures["turn_deg"] == pytest.approx(np.rad2deg(turn.magnitude()), abs=1e-3)
    assert figures["scale"] == pytest.approx(1 / scale, abs=1e-5)
    assert figures["rmse_um"] < 1e-4


def test_outliers_do_not_pull_the_alignment() -> None:
    vertices, faces = sheet(hills)
    points = vertices + np.array([0.0, 0.0, 0.3])
    points[::7] += [0.0, 0.0, 1.5]
    fitted = align_to_surface(points, make_surface(vertices, faces), "rigid")
    np.testing.assert_allclose(fitted.apply(vertices), vertices - [0, 0, 0.3], atol=0.01)


def test_a_result_unlike_the_truth_does_not_shrink_to_a_point_of_it() -> None:
    vertices, faces = sheet(hills)
    noise = vertices + RNG.normal(0, 6.0, (len(vertices), 1)) * [0.0, 0.0, 1.0]
    figures = surface_figures(make_surface(noise, faces), make_surface(vertices, faces), "similarity", UNITS)
    assert figures["scale"] == 1.0
    assert figures["rmse_um"] > 1.0


def test_a_cloud_has_distances_but_no_normals() -> None:
    truth = make_surface(*sheet(lambda x, y: 0 * x))
    cloud = Cloud(np.column_stack([RNG.uniform(-5, 5, (4000, 2)), np.full(4000, 0.3)]))
    figures = surface_figures(cloud, truth, "none", UNITS)
    assert figures["rmse_um"] == pytest.approx(0.3)
    assert np.isnan(figures["normal_angle_mean_deg"])
    with pytest.raises(ValueError, match="without points"):
        surface_figures(Cloud(np.empty((0, 3))), truth, "none", UNITS)


def test_a_surface_without_area_is_refused() -> None:
    with pytest.raises(ValueError, match="area"):
        make_surface(np.zeros((3, 3)), np.array([[0, 1, 2]]))


def test_a_large_triangle_is_sampled_everywhere() -> None:
    surface = make_surface(np.array([[0.0, 0, 0], [8, 0, 0], [0, 2, 0]]), np.array([[0, 1, 2]]))
    assert len(surface.area) > 10_000
    assert surface.area.sum() == pytest.approx(8.0)
    assert closest(surface, np.array([[1.0, 0.5, 7.0]])).distance[0] == pytest.approx(7.0)


def test_closest_points_are_those_of_brute_force() -> None:
    triangles = RNG.normal(0, 1, (300, 1, 3)) + RNG.normal(0, 0.3, (300, 3, 3))
    points = RNG.normal(0, 2, (200, 3))
    tree = make_tree(triangles)
    foot, distance, row = closest_on_triangles(tree, points)
    # An independent oracle: trimesh's closest point for every pair.
    repeated = np.repeat(points, len(triangles), axis=0)
    near = trimesh.triangles.closest_point(np.tile(triangles, (len(points), 1, 1)), repeated)
    away = np.linalg.norm(near - repeated, axis=1).reshape(len(points), -1)
    np.testing.assert_allclose(distance, away.min(axis=1), atol=1e-12)
    np.testing.assert_array_equal(tree.order[row], away.argmin(axis=1))
    np.testing.assert_allclose(np.linalg.norm(foot - points, axis=1), distance, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), scale=st.floats(0.2, 5.0))
def test_corresponding_points_give_back_their_similarity(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 3, (30, 3))
    true = Alignment(scale, Rotation.random(rng=rng).as_matrix(), rng.normal(0, 5, 3))
    fitted = align_points(points, true.apply(points), "similarity")
    np.testing.assert_allclose(fitted.apply(points), true.apply(points), atol=1e-8)
    np.testing.assert_allclose(fitted.undo(fitted.apply(points)), points, atol=1e-8)
    rigid = align_points(points, Alignment(1.0, true.rotation, true.translation_um).apply(points), "rigid")
    np.testing.assert_allclose(rigid.rotation, true.rotation, atol=1e-8)
    assert rigid.scale == 1.0


def test_a_mirror_image_is_no_alignment() -> None:
    points = RNG.normal(0, 1, (40, 3))
    fitted = align_points(points, points * [1, 1, -1], "rigid")
    assert np.linalg.det(fitted.rotation) == pytest.approx(1.0)
    assert np.abs(fitted.apply(points) - points * [1, 1, -1]).max() > 0.5


def test_none_changes_nothing_and_misuse_is_told() -> None:
    assert align_points(np.zeros((1, 3)), np.ones((1, 3)), "none").scale == identity().scale
    with pytest.raises(ValueError, match="one of none, rigid, similarity"):
        align_points(np.zeros((5, 3)), np.zeros((5, 3)), "affine")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="3 or more"):
        align_points(np.zeros((2, 3)), np.zeros((2, 3)), "rigid")
