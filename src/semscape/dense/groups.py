"""Views from all around, in groups that the dense stage knows: each group looks like a tilt series from its middle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semscape.geometry.rotations import CAM_FROM_WORLD_AT_ZERO_TILT, tilted_cam_from_world, wrap_axis_angle
from semscape.sfm.full_object import PARAMETERS_PER_VIEW, FullObjectMotion
from semscape.types import FloatArray, HeightMap, Motion, Observations, Reconstruction, TiltSeries

# Views of one group differ in tilt alone: by the stage's rotation they may differ as much as it errs, but no more.
_ONE_ROTATION_RAD = np.deg2rad(2.0)
_WIDEST_RAD = np.deg2rad(20.0)
_LEAST_POINTS = 8


@dataclass(frozen=True, eq=False)
class ViewGroup:
    """A tilt series of its own with its reconstruction, and where its world lies in that of the whole object.

    world = world_from_group @ (x, y, z, 1); `views` are the indices in the whole series.
    """

    views: tuple[int, ...]
    series: TiltSeries
    reconstruction: Reconstruction
    world_from_group: FloatArray


@dataclass(frozen=True, eq=False)
class PlacedMap:
    """The height map of a group and where it lies in the world of the whole object."""

    views: tuple[int, ...]
    height_map: HeightMap
    world_from_group: FloatArray

    @property
    def world_from_grid(self) -> FloatArray:
        """The map's own matrix leads into the world of its group; this one (4, 4) on into that of the object."""
        group_from_grid = self.height_map.world_from_grid
        return self.world_from_group @ group_from_grid


def group_views(motion: FullObjectMotion) -> list[tuple[int, ...]]:
    """Gather the views of one stage rotation whose tilts differ by up to 20 deg; a view that is alone is left out.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> tilt, turn = np.deg2rad([0.0, 30, 36, 30, 36]), np.deg2rad([0.0, 0, 0, 90, 90])
    >>> group_views(SimpleNamespace(tilt_rad=tilt, rotation_rad=turn))
    [(1, 2), (3, 4)]
    """
    groups: list[list[int]] = []
    for view in np.argsort(motion.tilt_rad, kind="stable"):
        for group in groups:
            first = group[0]
            turn = abs(np.angle(np.exp(1j * (motion.rotation_rad[view] - motion.rotation_rad[first]))))
            if turn < _ONE_ROTATION_RAD and motion.tilt_rad[view] - motion.tilt_rad[first] < _WIDEST_RAD:
                group.append(int(view))
                break
        else:
            groups.append([int(view)])
    return sorted(tuple(sorted(group)) for group in groups if len(group) > 1)


def view_group(views: tuple[int, ...], series: TiltSeries, motion: FullObjectMotion) -> ViewGroup | None:
    """Return some views as a tilt series of their own, seen from the middle one; None where they share no points.

    With R_m the rotation of the middle view, the group's world is turned by R_0^T R_m: there the middle view has no
    tilt. Its origin lies amid the points that two of the views see, on the ray through the middle view's centre.
    """
    ordered = sorted(views, key=lambda view: motion.tilt_rad[view])
    middle = ordered.index(ordered[len(ordered) // 2])
    rotations = motion.cam_from_world[ordered]
    group_from_world = CAM_FROM_WORLD_AT_ZERO_TILT.T @ rotations[middle]
    observations = motion.observations
    own = np.isin(observations.view, ordered)
    count = np.bincount(observations.point[own], minlength=observations.n_points)
    points = motion.adjustment.points_um[count >= 2]
    if len(points) < _LEAST_POINTS:
        return None
    per_view = motion.adjustment.parameters[1:].reshape(-1, PARAMETERS_PER_VIEW)[ordered]
    scale, anisotropy, translation = motion.scale_px_per_um[ordered], per_view[:, 3], per_view[:, 5:]
    stretch = scale[:, None] * np.column_stack([1 + anisotropy / 2, 1 - anisotropy / 2])
    centre = np.array(series.shape[::-1]) / 2 - 0.5
    origin = np.median(points, axis=0)
    seen_at = stretch[middle] * (rotations[middle, :2] @ origin) + translation[middle]
    origin = origin + rotations[middle, :2].T @ ((centre - seen_at) / stretch[middle])

    turned = rotations @ group_from_world.T
    # Towards the source, a view's beam leans across the axis by the sine of its tilt.
    leaning = turned[:, 2, :2]
    _, _, directions = np.linalg.svd(leaning)
    across = directions[0]
    axis, _ = wrap_axis_angle(float(np.arctan2(across[0], -across[1])))
    tilt = np.arcsin(np.clip(leaning @ [np.sin(axis), -np.cos(axis)], -1, 1))
    rest = turned @ np.swapaxes(tilted_cam_from_world(axis, tilt, np.zeros(len(tilt))), 1, 2)
    moved = Motion(
        axis_angle_rad=axis,
        tilt_rad=tilt,
        roll_rad=np.arctan2(rest[:, 1, 0], rest[:, 0, 0]),
        scale_px_per_um=scale,
        anisotropy=anisotropy,
        translation_px=translation + stretch * (rotations[:, :2] @ origin),
    )
    world_from_group = np.eye(4)
    world_from_group[:3, :3], world_from_group[:3, 3] = group_from_world.T, origin
    local = (points - origin) @ group_from_world.T
    chosen = TiltSeries(tuple(series.views[view] for view in ordered))
    return ViewGroup(tuple(ordered), chosen, _reconstruction(moved, local, middle, chosen), world_from_group)


def _reconstruction(motion: Motion, points: FloatArray, reference: int, series: TiltSeries) -> Reconstruction:
    """Return what the dense stage needs; the rest is the whole object's, and unknown here."""
    nothing, nowhere = np.empty(0), np.empty((0, 2))
    return Reconstruction(
        motion=motion,
        points_um=points,
        points_sigma_um=np.full(points.shape, np.nan),
        observations=Observations(nothing.astype(np.int64), nothing.astype(np.int64), nowhere),
        residual_px=nowhere,
        weights=nothing,
        covariance=np.full((1 + 6 * motion.n_views,) * 2, np.nan),
        tilt_sigma_rad=np.full(motion.n_views, np.nan),
        tilt_prior_rad=series.tilt_rad,
        tilt_source="metadata",
        height_scale_relative_sigma=np.nan,
        ambiguity="none",
        relief_confidence=1.0,
        rms_px=np.nan,
        reference=reference,
        length_unit=series.length_unit,
    )
