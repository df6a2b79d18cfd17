"""A full-object acquisition: the stage rotates the specimen about its normal and tilts it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from semscape.geometry.rotations import roll_rotation
from semscape.simulate import faults
from semscape.simulate.camera import scan_cameras
from semscape.simulate.mesh import MeshSpecimen
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.render import Scene
from semscape.simulate.series import draw_motion, micrographs
from semscape.types import FloatArray, IntArray, Micrograph, TiltSeries

_SEEDS_APART = 1000


@dataclass(frozen=True, eq=False)
class AllAround:
    """A full-object series with its truth: `cam_from_world` (V, 3, 3) and the surface."""

    series: TiltSeries
    cam_from_world: FloatArray
    specimen: MeshSpecimen


def simulate_all_around(
    specimen: MeshSpecimen,
    stops: Sequence[tuple[float, tuple[float, ...]]],
    options: SimulationOptions | None = None,
    *,
    rng: int = 0,
    workers: int | None = None,
) -> AllAround:
    """Take views of a specimen from all around.

    Parameters
    ----------
    specimen : MeshSpecimen
        Centred on the world's origin.
    stops : sequence of (float, tuple of float)
        The rotations of the stage in deg, counter-clockwise seen from the electron source, each with the tilts in deg
        at which views are taken.
    options : SimulationOptions, optional
        The acquisition, but for its tilts. Rotations are told as wrongly as tilts: by `stage_error_deg`.
    rng : int
        Seed, not negative.
    workers : int, optional
        Threads; all cores where left out. It changes no result.

    Examples
    --------
    >>> small = SimulationOptions(width_px=32, height_px=32)
    >>> found = simulate_all_around(spiny_sphere(1.0, 2), [(0.0, (0.0, 6.0)), (90.0, (30.0,))], small)
    >>> found.series.n_views, round(float(np.rad2deg(found.series.views[2].metadata.tilt_rad)))
    (3, 30)
    """
    options = options or SimulationOptions()
    scene = Scene(specimen, options, os.cpu_count() or 1 if workers is None else workers)
    views: list[Micrograph] = []
    rotations: list[FloatArray] = []
    for index, (told_deg, tilts_deg) in enumerate(stops):
        seed = rng + _SEEDS_APART * index
        there = replace(options, tilts_deg=tilts_deg)
        motion, _, skew = draw_motion(there, seed)
        error_deg = options.stage_error_deg * float(faults.stream(seed, "rotation").standard_normal())
        rotation_rad = math.radians(told_deg - error_deg)
        cameras = tuple(
            replace(camera, rotation=camera.rotation @ roll_rotation(rotation_rad))
            for camera in scan_cameras(motion, skew, options.working_distance_um or math.inf)
        )
        taken, *_ = micrographs(replace(scene, options=there), motion, cameras, seed, rotation_rad)
        rotations += [camera.rotation for camera in cameras]
        views += [
            replace(
                view,
                name=f"rotation_{told_deg:03.0f}_{view.name}",
                metadata=replace(view.metadata, stage_rotation_rad=math.radians(told_deg)),
            )
            for view in taken.views
        ]
    return AllAround(TiltSeries(tuple(views)), np.stack(rotations), specimen)


def spiny_sphere(radius_um: float, spines: int, *, fineness: int = 5, rng: int = 0) -> MeshSpecimen:
    """Return a closed sphere with up to so many spines, up to a fifth of the radius high.

    `fineness` is how many times the triangles of an icosahedron are quartered. The spines stand at random places: a
    regular lattice looks alike from several sides.
    """
    from trimesh.creation import icosphere

    generator = faults.stream(rng, "spines")
    ball = icosphere(subdivisions=fineness)
    direction = np.asarray(ball.vertices, np.float64)
    width = math.sqrt(4 * math.pi / spines)
    tips: list[FloatArray] = []
    for _ in range(20 * spines):
        tip = generator.standard_normal(3)
        tip /= np.linalg.norm(tip)
        if all(tip @ other < math.cos(0.7 * width) for other in tips) and len(tips) < spines:
            tips.append(tip)
    height = generator.uniform(0.08, 0.2, len(tips))
    sharpness = width * generator.uniform(0.12, 0.25, len(tips))
    angle = np.arccos(np.clip(direction @ np.array(tips).T, -1, 1))
    radius = radius_um * (1 + (height * np.exp(-0.5 * (angle / sharpness) ** 2)).max(axis=1))
    faces: IntArray = np.asarray(ball.faces, np.int64)
    return MeshSpecimen("spiny sphere", direction * radius[:, None], faces, int(generator.integers(2**31)))
