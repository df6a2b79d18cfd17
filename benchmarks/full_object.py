"""A spiny sphere seen from all around, reconstructed and compared with its true mesh, as JSON."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from isolated import Case, peak_memory_mb, run_cases, timed

if TYPE_CHECKING:
    from semscape.simulate.all_around import AllAround

_RADIUS = 0.33
_RING_DEG = range(0, 360, 36)
_STOPS = ((0.0, (-6.0, 0.0, 6.0)), (0.0, (18.0, 24.0)), *((float(turn), (36.0, 42.0, 48.0)) for turn in _RING_DEG))


def all_around(side_px: int) -> AllAround:
    """Return 35 views of a spiny sphere: from above, and three tilts at ten rotations of the stage."""
    from semscape.simulate import PRESETS
    from semscape.simulate.all_around import simulate_all_around, spiny_sphere

    options = replace(PRESETS["nominal"], width_px=side_px, height_px=side_px, samples=1, shift_px=3.0)
    radius_um = _RADIUS * side_px * options.pixel_size_um
    return simulate_all_around(spiny_sphere(radius_um, 60), _STOPS, options, rng=0)


def measure(side_px: int) -> dict[str, Any]:
    """Simulate, reconstruct and evaluate; what lies lower than any view can see does not count as missing."""
    import numpy as np
    import trimesh

    from semscape.evaluate.align import Alignment
    from semscape.evaluate.distances import surface_figures
    from semscape.evaluate.surface import make_surface
    from semscape.evaluate.units import Units
    from semscape.pipeline import reconstruct_full_object

    taken = all_around(side_px)
    pixel = float(taken.series.pixel_size_um[0])
    radius = _RADIUS * side_px * pixel
    (found, stages, failures), seconds = timed(reconstruct_full_object, taken.series, rng=0)
    true_vertices, true_faces = taken.specimen.vertices_um, taken.specimen.faces
    within_reach = true_vertices[true_faces].mean(axis=1)[:, 2] > -0.4 * radius
    truth = make_surface(true_vertices, true_faces, within_reach)
    # The world's frame is the stage's up to what the images leave open, which the cameras tell.
    u, _, vt = np.linalg.svd(np.einsum("vij,vik->jk", taken.cam_from_world, found.motion.cam_from_world))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    mesh, seen = found.merged.mesh, found.merged.seen
    shift = true_vertices.mean(axis=0) - turn @ mesh.vertices_um.mean(axis=0)
    start = Alignment(1.0, turn, shift)
    kept = seen[mesh.faces].all(axis=1) & (
        (mesh.vertices_um @ turn.T + shift)[mesh.faces].mean(axis=1)[:, 2] > -0.4 * radius
    )
    units = Units(pixel, float(np.ptp(true_vertices[:, 2])))
    figures = surface_figures(make_surface(mesh.vertices_um, mesh.faces[kept]), truth, "rigid", units, start=start)
    body = trimesh.Trimesh(mesh.vertices_um, mesh.faces, process=False)
    true_body = trimesh.Trimesh(true_vertices, true_faces, process=False)
    return {
        "views": taken.series.n_views,
        "groups": len(found.maps),
        "pairs_failed": len(failures),
        "watertight": bool(body.is_watertight),
        "euler_number": int(body.euler_number),
        "measured": round(found.merged.measured, 4),
        "volume_ratio": round(float(body.volume / true_body.volume), 4),
        "rigid": {key: value for key, value in figures.items() if key.endswith(("_px", "_deg"))},
        "seconds": round(seconds, 1),
        "stages": {stage.name: round(stage.seconds, 1) for stage in stages},
        "peak_memory_mb": round(peak_memory_mb()),
    }


CASES: dict[str, Case] = {"spiny-sphere": (measure, (320,))}

if __name__ == "__main__":
    run_cases(CASES, "A full object against its true mesh, as JSON.")
