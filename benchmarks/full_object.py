"""Bodies seen from all around, reconstructed and compared with their true meshes, as JSON."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from isolated import Case, peak_memory_mb, run_cases, timed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from semscape.dense.full_object import FullObject
    from semscape.simulate.all_around import AllAround
    from semscape.simulate.mesh import MeshSpecimen

_SIDE_PX = 320
_RING_DEG = range(0, 360, 36)
_STOPS = ((0.0, (-6.0, 0.0, 6.0)), (0.0, (18.0, 24.0)), *((float(turn), (36.0, 42.0, 48.0)) for turn in _RING_DEG))
# A place is within reach where two views of a group see it more squarely than this.
_MOST_OBLIQUE_DEG = 72.0


def all_around(side_px: int, specimen: str = "spiny-sphere", seed: int = 0, background_noise: float = 0.0) -> AllAround:
    """Return 35 views of a body: from above, and three tilts at ten rotations of the stage.

    The simulated void is black without any noise, as where a microscope clips it; `background_noise` is the rms, in
    grey levels, of what a detector adds everywhere.
    """
    import numpy as np

    from semscape.simulate import PRESETS
    from semscape.simulate.all_around import simulate_all_around
    from semscape.types import TiltSeries

    options = replace(PRESETS["nominal"], width_px=side_px, height_px=side_px, samples=1, shift_px=3.0)
    taken = simulate_all_around(body(specimen, side_px * options.pixel_size_um, seed), _STOPS, options, rng=seed)
    if not background_noise:
        return taken
    rng = np.random.default_rng(seed)
    views = tuple(
        replace(
            view,
            image=np.rint(view.image + background_noise * rng.standard_normal(view.image.shape)).astype(np.float32),
        )
        for view in taken.series.views
    )
    return replace(taken, series=TiltSeries(views))


def body(specimen: str, field_um: float, seed: int) -> MeshSpecimen:
    """Return a closed body, about two thirds of the field long."""
    import numpy as np
    from trimesh import Trimesh
    from trimesh.creation import icosphere, torus
    from trimesh.remesh import subdivide_to_size

    from semscape.simulate.all_around import spiny_sphere
    from semscape.simulate.mesh import MeshSpecimen

    if specimen == "spiny-sphere":
        return spiny_sphere(0.33 * field_um, 60 if seed == 0 else 30, rng=seed)
    if specimen == "ellipsoid":
        mesh = icosphere(subdivisions=5)
        mesh.apply_scale([0.36, 0.28, 0.2])
    elif specimen == "ring":
        mesh = torus(0.25, 0.09, major_sections=160, minor_sections=64)
    else:  # an angle section: flat faces, sharp edges, and a corner that no star reaches
        profile = np.array([(-0.25, -0.2), (0.25, -0.2), (0.25, -0.05), (-0.08, -0.05), (-0.08, 0.2), (-0.25, 0.2)])
        ends = [np.column_stack([profile[:, 0], np.full(6, y), profile[:, 1]]) for y in (-0.17, 0.17)]
        caps = np.array([(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)])
        a, b = np.arange(6), np.roll(np.arange(6), -1)
        sides = np.concatenate([np.column_stack([a, a + 6, b]), np.column_stack([b, a + 6, b + 6])])
        faces = np.concatenate([caps, caps[:, ::-1] + 6, sides])
        mesh = Trimesh(*subdivide_to_size(np.concatenate(ends), faces, 0.014))
    rough = np.asarray(mesh.vertices) + _waves(np.asarray(mesh.vertices), seed)
    mesh = Trimesh(rough, mesh.faces, process=False)
    faces = mesh.faces if mesh.volume > 0 else mesh.faces[:, ::-1]
    return MeshSpecimen(specimen, rough * field_um, np.asarray(faces, np.int64), seed)


def _waves(places: NDArray[Any], seed: int) -> NDArray[Any]:
    """Return displacements (P, 3) by plane waves in random directions, the shorter the lower."""
    import numpy as np

    rng = np.random.default_rng(seed)
    moved = np.zeros_like(places)
    for length in np.geomspace(0.04, 0.2, 40):
        direction = rng.standard_normal(3)
        wave = np.sin(2 * np.pi / length * places @ direction / np.linalg.norm(direction) + rng.uniform(0, 2 * np.pi))
        moved += 0.006 * length * rng.standard_normal(3) * wave[:, None]
    return moved


def within_reach(taken: AllAround, groups: list[tuple[int, ...]]) -> NDArray[Any]:
    """Tell of which true faces (F,) two views of one group see the middle squarely enough."""
    import numpy as np
    import trimesh

    mesh = trimesh.Trimesh(taken.specimen.vertices_um, taken.specimen.faces, process=False)
    pixel = float(taken.series.pixel_size_um[0])
    dense = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.8 * pixel, max_iter=30)[0]
    middles, normals = mesh.triangles_center, mesh.face_normals
    seen = np.zeros((taken.series.n_views, len(middles)), np.bool_)
    for k, rotation in enumerate(taken.cam_from_world):
        # The nearest of all points in each pixel is what the view sees; half a sample of slack along the beam.
        nodes, places = dense @ rotation.T, middles @ rotation.T
        toward = 1.0 if rotation[2] @ [0, 0, 1] > 0 else -1.0
        low = nodes[:, :2].min(axis=0) - 2 * pixel
        depth = np.full(np.ceil((np.ptp(nodes[:, :2], axis=0) + 6 * pixel) / pixel).astype(int), -np.inf)
        np.maximum.at(depth, tuple(np.rint((nodes[:, :2] - low) / pixel).astype(int).T), toward * nodes[:, 2])
        nearest = depth[tuple(np.rint((places[:, :2] - low) / pixel).astype(int).T)]
        square = toward * (normals @ rotation[2])
        seen[k] = (square > np.cos(np.deg2rad(_MOST_OBLIQUE_DEG))) & (toward * places[:, 2] > nearest - 4 * pixel)
    reached: NDArray[Any] = np.any([seen[list(group)].sum(axis=0) >= 2 for group in groups], axis=0)
    return reached


def figures_of(taken: AllAround, found: FullObject) -> dict[str, Any]:
    """Compare with the truth: what is told as seen with all of it, what can be seen with what is told as seen."""
    import numpy as np
    import trimesh

    from semscape.evaluate.align import Alignment
    from semscape.evaluate.distances import surface_figures
    from semscape.evaluate.surface import make_surface
    from semscape.evaluate.units import Units

    pixel = float(taken.series.pixel_size_um[0])
    true_vertices, true_faces = taken.specimen.vertices_um, taken.specimen.faces
    reached = within_reach(taken, [placed.views for placed in found.maps])
    truth = make_surface(true_vertices, true_faces, reached)
    # The world's frame is the stage's up to what the images leave open, which the cameras tell.
    u, _, vt = np.linalg.svd(np.einsum("vij,vik->jk", taken.cam_from_world, found.motion.cam_from_world))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    mesh, seen = found.merged.mesh, found.merged.seen
    seen_faces = seen[mesh.faces].all(axis=1)
    top = mesh.vertices_um @ turn.T
    middle = [(vertices.min(axis=0) + vertices.max(axis=0)) / 2 for vertices in (true_vertices, top)]
    shift = middle[0] - middle[1]
    shift[2] = true_vertices[:, 2].max() - top[:, 2].max()
    units = Units(pixel, float(np.ptp(true_vertices[:, 2])))
    measured = make_surface(mesh.vertices_um, mesh.faces[seen_faces])
    figures = surface_figures(measured, truth, "rigid", units, start=Alignment(1.0, turn, shift))
    found_body = trimesh.Trimesh(mesh.vertices_um, mesh.faces, process=False)
    true_body = trimesh.Trimesh(true_vertices, true_faces, process=False)
    area = true_body.area_faces
    return {
        "watertight": bool(found_body.is_watertight),
        "euler_number": int(found_body.euler_number),
        "true_euler_number": int(true_body.euler_number),
        "measured": round(found.merged.measured, 4),
        "within_reach": round(float(area[reached].sum() / area.sum()), 4),
        "volume_ratio": round(float(found_body.volume / true_body.volume), 4),
        "area_ratio": round(float(found_body.area / true_body.area), 4),
        "rigid": {key: value for key, value in figures.items() if key.endswith(("_px", "_deg", "_1px"))},
    }


def measure(side_px: int, *specimen: Any) -> dict[str, Any]:
    """Simulate, reconstruct and evaluate."""
    from semscape.pipeline import reconstruct_full_object

    taken = all_around(side_px, *specimen)
    (found, stages, failures), seconds = timed(reconstruct_full_object, taken.series, rng=0)
    return {
        "views": taken.series.n_views,
        "groups": len(found.maps),
        "pairs_failed": len(failures),
        **figures_of(taken, found),
        "seconds": round(seconds, 1),
        "stages": {stage.name: round(stage.seconds, 1) for stage in stages},
        "peak_memory_mb": round(peak_memory_mb()),
    }


CASES: dict[str, Case] = {
    "spiny-sphere": (measure, (_SIDE_PX, "spiny-sphere")),
    "noisy-void": (measure, (_SIDE_PX, "spiny-sphere", 1, 2.0)),
    "ellipsoid": (measure, (_SIDE_PX, "ellipsoid", 2)),
    "angle": (measure, (_SIDE_PX, "angle", 3)),
    "ring": (measure, (_SIDE_PX, "ring", 4)),
}

if __name__ == "__main__":
    run_cases(CASES, "Full objects against their true meshes, as JSON.")
