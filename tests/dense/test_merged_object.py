"""A body from all around: groups of views, maps laid onto each other, one watertight mesh."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from semscape.dense.groups import PlacedMap, group_views, view_group
from semscape.dense.merge import merge_maps
from semscape.dense.register import register_maps
from semscape.errors import NoAnswerError
from semscape.geometry.cameras import camera_matrices
from semscape.geometry.rotations import axis_rotation, roll_rotation, tilted_cam_from_world
from semscape.sfm.adjust import Adjustment
from semscape.sfm.full_object import PARAMETERS_PER_VIEW, FullObjectMotion
from semscape.types import FloatArray, HeightMap, Micrograph, Observations, SemMetadata, TiltSeries

PIXEL = 0.1
SIDE = 96
RADIUS = 3.6
BUMPS = np.random.default_rng(0).normal(size=(24, 3))
BUMPS /= np.linalg.norm(BUMPS, axis=1, keepdims=True)


def true_radius(direction: FloatArray) -> FloatArray:
    """Return the radius of a ball with bumps along unit vectors (..., 3)."""
    return RADIUS * (1 + 0.12 * np.exp(40 * (np.max(direction @ BUMPS.T, axis=-1) - 1)))


def seen_from(turn: FloatArray, rng: np.random.Generator) -> PlacedMap:
    """Return the true height map of the ball in a frame that `turn` takes to the world, with noise of half a px."""
    row, col = np.indices((SIDE, SIDE))
    x, y = (col - (SIDE - 1) / 2) * PIXEL, -(row - (SIDE - 1) / 2) * PIXEL
    height = np.full(x.shape, np.nan)
    for z in np.arange(1.4 * RADIUS, -0.2 * RADIUS, -0.25 * PIXEL):  # from above, to the first place inside
        place = np.stack([x, y, np.full_like(x, z)], axis=-1)
        length = np.linalg.norm(place, axis=-1)
        inside = length < true_radius(place / length[..., None] @ turn.T)
        height[np.isnan(height) & inside] = z
    height += 0.5 * PIXEL * rng.standard_normal(height.shape)
    known = np.isfinite(height).astype(np.uint8)
    grid = np.diag([PIXEL, -PIXEL, 1.0, 1.0])
    grid[:2, 3] = -PIXEL * (SIDE - 1) / 2, PIXEL * (SIDE - 1) / 2
    found = HeightMap(height, height * 0 + PIXEL, 3 * known, (128 + 0 * x).astype(np.float32), PIXEL, grid, "um")
    world_from_group = np.eye(4)
    world_from_group[:3, :3] = turn
    return PlacedMap((0, 1), found, world_from_group)


@cache
def maps() -> tuple[PlacedMap, ...]:
    rng = np.random.default_rng(1)
    around = [roll_rotation(turn) @ axis_rotation(0.0, np.deg2rad(50)) for turn in np.deg2rad(np.arange(0, 360, 60))]
    return tuple(seen_from(turn, rng) for turn in (np.eye(3), *around))


def distances_px(vertices: FloatArray) -> FloatArray:
    length = np.linalg.norm(vertices, axis=1)
    return np.abs(length - true_radius(vertices / length[:, None])) / PIXEL


def test_merged_maps_are_watertight_and_lie_on_the_body() -> None:
    merged = merge_maps(maps())
    mesh = trimesh.Trimesh(merged.mesh.vertices_um, merged.mesh.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0  # outside is outside
    assert mesh.euler_number == 2  # no handle, no bubble
    error = distances_px(merged.mesh.vertices_um[merged.seen])
    assert 0.02 < np.median(error) < 0.5
    assert np.percentile(error, 95) < 2
    assert 0.6 < merged.measured < 1  # the foot, which no map sees, is closed but not called measured
    below = merged.mesh.vertices_um[:, 2] < -0.97 * RADIUS
    assert not merged.seen[below].any()


def test_a_fringe_that_floats_before_what_others_see_is_left_out() -> None:
    first, *others = maps()
    height = first.height_map.height_um.copy()
    row, col = np.indices(height.shape)
    beside = np.isnan(height) & (np.hypot(row - SIDE / 2, col - SIDE / 2) < 46)
    height[beside] = 0.0
    fringed = replace(first, height_map=replace(first.height_map, height_um=height))
    merged = merge_maps([fringed, *others])
    assert np.percentile(distances_px(merged.mesh.vertices_um[merged.seen]), 95) < 2.5


def test_what_one_map_sees_and_none_of_those_that_look_there_is_left_out() -> None:
    """A brim beyond the outline, low where no other map sees anything behind it."""
    given = list(maps())
    for k in (1, 3, 5):
        height = given[k].height_map.height_um.copy()
        row, col = np.indices(height.shape)
        grid = np.stack([col, row, np.zeros_like(height), np.ones_like(height)], axis=-1)
        low = (grid @ given[k].world_from_grid.T)[..., 2] < -0.6 * RADIUS
        height[np.isnan(height) & low & (np.hypot(row - SIDE / 2, col - SIDE / 2) < 46)] = 0.0
        given[k] = replace(given[k], height_map=replace(given[k].height_map, height_um=height))
    merged = merge_maps(given)
    assert np.percentile(distances_px(merged.mesh.vertices_um[merged.seen]), 98) < 3


def test_maps_that_calibration_has_shifted_and_turned_find_their_places() -> None:
    rng = np.random.default_rng(2)
    spoilt = [maps()[0]]
    for placed in maps()[1:]:
        moved = np.eye(4)
        moved[:3, 3] = PIXEL * rng.normal(0, 5, 3)
        moved[:3, :3] = axis_rotation(rng.uniform(0, np.pi), np.deg2rad(rng.normal(0, 0.3)))
        spoilt.append(replace(placed, world_from_group=moved @ placed.world_from_group))
    found = register_maps(spoilt)
    for one, true in zip(found, maps(), strict=True):
        rest = one.world_from_group @ np.linalg.inv(true.world_from_group)
        before = np.linalg.norm(rest[:3, 3]) / PIXEL
        assert before < 0.7
        assert np.rad2deg(np.arccos((np.trace(rest[:3, :3]) - 1) / 2)) < 0.9  # drawn with 0.3


def test_maps_that_share_nothing_give_no_answer() -> None:
    empty = replace(maps()[0].height_map, height_um=np.full((SIDE, SIDE), np.nan))
    with pytest.raises(NoAnswerError, match="agree on 0 places"):
        merge_maps([replace(maps()[0], height_map=empty)])


def test_a_group_images_the_object_as_its_views_did() -> None:
    tilt, turn = np.deg2rad([30.0, 36.0, 42.0, 31.0]), np.deg2rad([80.0, 80.0, 80.0, 200.0])
    rng = np.random.default_rng(3)
    roll, relative, anisotropy = (rng.normal(0, sigma, 4) for sigma in (0.01, 0.002, 0.002))
    rotations = tilted_cam_from_world(1.5, tilt, roll) @ roll_rotation(turn)
    shift = rng.normal(300, 20, (4, 2))
    per_view = np.column_stack([tilt, roll, relative, anisotropy, turn, shift])
    assert per_view.shape[1] == PARAMETERS_PER_VIEW
    points = rng.normal(0, 5, (60, 3))
    blank = np.zeros((480, 640), np.float32)
    metadata = SemMetadata(pixel_size_um=0.1)
    series = TiltSeries(tuple(Micrograph(f"{k}.tif", blank, blank == 0, metadata) for k in range(4)))
    scale = 10 * (1 + relative)
    stretch = scale[:, None] * np.column_stack([1 + anisotropy / 2, 1 - anisotropy / 2])
    xy = stretch[:, None] * np.einsum("vij,pj->vpi", rotations[:, :2], points) + shift[:, None]
    adjustment = Adjustment(
        np.concatenate([[1.5], per_view.ravel()]), np.eye(1), points, np.eye(1), np.eye(1), 1.0, 1.0, 1
    )
    observations = Observations(
        np.tile(np.arange(4), 60), np.repeat(np.arange(60), 4), xy.transpose(1, 0, 2).reshape(-1, 2)
    )
    motion = FullObjectMotion(rotations, 1.5, tilt, turn, scale, observations, adjustment)
    assert group_views(motion) == [(0, 1, 2)]
    group = view_group((0, 1, 2), series, motion)
    assert group is not None
    own = np.linalg.inv(group.world_from_group)
    local = points @ own[:3, :3].T + own[:3, 3]
    again = np.einsum("vij,pj->vpi", camera_matrices(group.reconstruction.motion), local)
    again += group.reconstruction.motion.translation_px[:, None]
    assert np.allclose(again, xy[:3], atol=1e-6)
    centre = group.reconstruction.motion.translation_px[group.reconstruction.reference]
    assert np.allclose(centre, [319.5, 239.5])
    assert np.allclose(group.reconstruction.motion.tilt_rad, tilt[:3] - tilt[1], atol=0.002)
