"""Seconds per view of one megapixel of the simulated microscope on two threads (`make simulator-speed`).

A view costs half of what a series of three takes longer than a series of one: the specimen, what is computed once
of it, and the compilation are left out. On a machine with other work the processor's seconds, summed over the
threads, tell more than the clock's.
"""

from __future__ import annotations

import time
from typing import Any

from isolated import Case, run_cases

_SIZE_PX = 1000
_THREADS = 2


def measure(what: str, tilt_deg: float, detector: str) -> dict[str, Any]:
    """Time one view."""
    from dataclasses import replace

    import trimesh

    from semscape.simulate import PRESETS, MeshSpecimen, acquire

    specimen: Any = what
    if what == "mesh":
        ball = trimesh.creation.icosphere(subdivisions=6, radius=45.0)
        specimen = MeshSpecimen("ball", ball.vertices, ball.faces)
    options = replace(PRESETS["nominal"], width_px=_SIZE_PX, height_px=_SIZE_PX, detector=detector)
    acquire(specimen, replace(options, width_px=32, height_px=32, tilts_deg=(tilt_deg,)), workers=_THREADS)

    def seconds(views: int) -> tuple[float, float]:
        # Tilts a hair apart: the same work for each view.
        tilts = tuple(tilt_deg + 0.01 * view for view in range(views))
        clock, processor = time.perf_counter(), time.process_time()
        acquire(specimen, replace(options, tilts_deg=tilts), workers=_THREADS)
        return time.perf_counter() - clock, time.process_time() - processor

    one, three = seconds(1), seconds(3)
    return {
        "megapixels": _SIZE_PX**2 / 1e6,
        "samples_per_pixel": options.samples**2,
        "threads": _THREADS,
        "seconds_per_view": round((three[0] - one[0]) / 2, 3),
        "processor_seconds_per_view": round((three[1] - one[1]) / 2, 3),
        "seconds_before_the_first_view": round(one[0] - (three[0] - one[0]) / 2, 3),
    }


CASES: dict[str, Case] = {
    f"{what}{tilt:+g}{'' if detector == 'se' else '-' + detector}": (measure, (what, tilt, detector))
    for what, tilt, detector in (
        ("fracture", 0.0, "se"),
        ("fracture", 60.0, "se"),
        ("fracture", -60.0, "se"),
        ("fracture", 0.0, "bse-4"),
        ("mesh", 0.0, "se"),
        ("mesh", 60.0, "se"),
    )
}

if __name__ == "__main__":
    run_cases(CASES, "Seconds per simulated view, as JSON.")
