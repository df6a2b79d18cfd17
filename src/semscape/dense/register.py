"""Lay the height maps of a full-object series onto each other.

Tracks tie views that differ little; those on either side of a gap in the series are tied by the stage's rotation alone,
and not at all in their places. But the maps overlap, and their shapes tell what the tracks do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from semscape.dense.groups import PlacedMap
from semscape.dense.samples import Samples, map_samples
from semscape.types import FloatArray

_POINTS_PER_MAP = 4000
_SQUARE_ENOUGH = np.cos(np.deg2rad(60.0))
# How far a surface is looked for, from coarse to fine, in px and rounds; only the last ones turn the map as well.
_GATES_PX = ((48.0, 12), (24.0, 10), (12.0, 10), (6.0, 10), (4.0, 10))
_TURNING_PX = 12.0
_SETTLING_ROUNDS = 2
_SAME_SIDE = 0.6
_LEAST_PAIRS = 100
# Calibration knows how a map is turned to this; a round body hardly tells. Neighbouring distances err alike, so many.
_TURN_SIGMA_RAD = np.deg2rad(0.3)
_NOISE_PX = 1.0
_ALIKE = 10


@dataclass(frozen=True, eq=False)
class _Surface:
    points: FloatArray
    normals: FloatArray


def register_maps(maps: Sequence[PlacedMap]) -> list[PlacedMap]:
    """Move maps so that they agree where they overlap, the first one least.

    The map that shares most with the others stays; one after the other is laid onto those that lie already, then each
    onto all others. A map that overlaps with none stays as it was.

    Parameters
    ----------
    maps : sequence of PlacedMap
        Where calibration has put them: turned right to about a degree, shifted by up to 50 px.

    References
    ----------
    Chen & Medioni 1992, doi:10.1016/0262-8856(92)90066-C (point to plane).
    """
    pixel = maps[0].height_map.pixel_size_um
    surfaces = [_thinned(map_samples(placed)) for placed in maps]
    poses = [np.eye(4) for _ in maps]
    up = [placed.world_from_group[:3, 2] for placed in maps]
    order = [int(np.argmax(np.sum(np.array(up) @ np.array(up).T, axis=1)))]
    while len(order) < len(maps):
        near = [max(float(up[k] @ up[laid]) for laid in order) for k in range(len(maps))]
        order.append(max((k for k in range(len(maps)) if k not in order), key=lambda k: near[k]))
    for count in range(1, len(order)):
        target = _union([_moved(surfaces[k], poses[k]) for k in order[:count]])
        poses[order[count]] = _laid(surfaces[order[count]], poses[order[count]], target, pixel, _GATES_PX)
    for _ in range(_SETTLING_ROUNDS):
        for k in order[1:]:
            target = _union([_moved(surfaces[other], poses[other]) for other in order if other != k])
            poses[k] = _laid(surfaces[k], poses[k], target, pixel, _GATES_PX[-2:])
    return [
        replace(placed, world_from_group=pose @ placed.world_from_group)
        for placed, pose in zip(maps, poses, strict=True)
    ]


def _thinned(samples: Samples) -> _Surface:
    good = np.flatnonzero(samples.squareness >= _SQUARE_ENOUGH)
    good = good[:: max(1, len(good) // _POINTS_PER_MAP)]
    return _Surface(samples.points[good], samples.normals[good])


def _moved(surface: _Surface, pose: FloatArray) -> _Surface:
    return _Surface(surface.points @ pose[:3, :3].T + pose[:3, 3], surface.normals @ pose[:3, :3].T)


def _union(surfaces: list[_Surface]) -> _Surface:
    return _Surface(np.concatenate([one.points for one in surfaces]), np.concatenate([one.normals for one in surfaces]))


def _laid(
    surface: _Surface, pose: FloatArray, target: _Surface, pixel: float, gates: tuple[tuple[float, int], ...]
) -> FloatArray:
    """Return the pose that lays a surface onto a target, by least squares of the distances along the normals."""
    tree = cKDTree(target.points)
    centre = surface.points.mean(axis=0)
    for gate_px, rounds in gates:
        gate = gate_px * pixel
        for _ in range(rounds):
            now = _moved(surface, pose)
            distance, near = tree.query(now.points, distance_upper_bound=gate)
            found = np.flatnonzero(np.isfinite(distance))
            normals = target.normals[near[found]]
            found = found[same := np.einsum("nk,nk->n", now.normals[found], normals) > _SAME_SIDE]
            normals = normals[same]
            if len(found) < _LEAST_PAIRS:
                break
            points = now.points[found]
            rest = np.einsum("nk,nk->n", target.points[near[found]] - points, normals)
            weight = 1 / (1 + (rest / (0.3 * gate)) ** 2)
            about = centre @ pose[:3, :3].T + pose[:3, 3]
            design = np.column_stack([normals, np.cross(points - about, normals)])
            if gate_px > _TURNING_PX:
                design = design[:, :3]
            information = (design.T * weight) @ design
            pull = (design.T * weight) @ rest
            if design.shape[1] == 6:
                trust = _ALIKE * (_NOISE_PX * pixel / _TURN_SIGMA_RAD) ** 2
                information[3:, 3:] += trust * np.eye(3)
                pull[3:] -= trust * Rotation.from_matrix(pose[:3, :3]).as_rotvec()
            step = np.zeros(6)
            step[: design.shape[1]] = np.linalg.lstsq(information, pull)[0]
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix()
            turn[:3, 3] = about + step[:3] - turn[:3, :3] @ about
            pose = turn @ pose
            if np.abs(step[:3]).max() < 0.01 * pixel:
                break
    return pose
