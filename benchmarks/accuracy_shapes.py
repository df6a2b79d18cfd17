"""Shapes of known size in the surfaces of `accuracy_dense.py`: a step, the faces of an indent, vertical walls.

Regions and walls are those of the truth: a shape is measured where it is, not where a result has it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from semscape.evaluate.height_errors import HeightError
    from semscape.simulate.specimens import Specimen, SpecimenSize
    from semscape.types import FloatArray, SimulationTruth

STEP_SHARE = 0.05
_STEP_SLOPE = 0.05
_CLEAR_PX = 16
_HALF_WIDTH_SHARE = 0.32
_FACE_MARGIN_SHARE = 0.04
_BEFORE_PX, _BEHIND_PX = 15, 17


def step_specimen(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make two parallel planes, slightly inclined, of which the right one is higher by 5 % of the field."""
    import numpy as np

    from semscape.simulate.specimens import Specimen

    x, y = size.axes_um()
    height = np.where(x > 0.0, STEP_SHARE * size.field_um, 0.0) + _STEP_SLOPE * (0.6 * x + 0.8 * y)
    height -= STEP_SHARE * size.field_um / 2
    return Specimen("step", height.astype(np.float32), size.pitch_um, int(rng.integers(0, 2**31)))


def shape_figures(specimen: str, found: HeightError, truth: SimulationTruth) -> dict[str, Any]:
    """Return what a specimen's shape is in a height map, beside what it truly is; empty where it has none."""
    measure = _SHAPES.get(specimen)
    return measure(found, truth) if measure else {}


def _step(found: HeightError, truth: SimulationTruth) -> dict[str, Any]:
    """Return the height of the step, px; away from the edge by more than its parallax."""
    import numpy as np

    from semscape.metrology.step import step_between_regions

    pixel = truth.pixel_size_um
    x = found.true_um[..., 0] / pixel
    columns = truth.height_um.shape[1]
    near = np.abs(x) < columns / 3
    regions = near & (x < -_CLEAR_PX), near & (x > _CLEAR_PX)
    true = STEP_SHARE * min(truth.height_um.shape)
    height = step_between_regions(_height(found) / pixel, 1.0, *regions).height
    return {"step_px": round(height, 3), "true_step_px": round(true, 3), "allowed_px": round(0.005 * true + 0.1, 3)}


def _faces(found: HeightError, truth: SimulationTruth) -> dict[str, Any]:
    """Return the angles between the opposite faces of the indent, deg, and those of the true surface's same places."""
    import numpy as np

    from semscape.metrology.planes import angle_between, fit_plane
    from semscape.simulate import faults

    pixel = truth.pixel_size_um
    field = min(truth.height_um.shape) * pixel
    turn = faults.stream(truth.seed, "specimen").uniform(0, np.pi / 2)  # the specimen's first draw
    x, y = found.true_um[..., 0], found.true_um[..., 1]
    u, v = x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)
    margin = _FACE_MARGIN_SHARE * field
    inside = np.maximum(np.abs(u), np.abs(v)) < _HALF_WIDTH_SHARE * field - margin

    def angles(height: FloatArray) -> list[float]:
        out = []
        for along, across in ((u, v), (v, u)):
            face = inside & (np.abs(along) > np.abs(across) + margin)
            sides = [fit_plane(height, pixel, face & (sign * along > 0)) for sign in (1, -1)]
            out.append(round(180 - math.degrees(angle_between(*sides)), 2))
        return out

    return {"face_angles_deg": angles(_height(found)), "true_face_angles_deg": angles(found.true_um[..., 2])}


def _walls(found: HeightError, truth: SimulationTruth) -> dict[str, Any]:
    """Return how many px, across the wall, heights take from 10 to 90 % of it: quartiles and 90th percentile."""
    import numpy as np

    from semscape.simulate import faults

    turn = faults.stream(truth.seed, "specimen").uniform(0, np.pi)  # the specimen's first draw
    true, height = found.true_um[..., 2], _height(found)
    steeper = abs(math.cos(turn))
    if steeper < math.sqrt(0.5):
        true, height, steeper = true.T, height.T, abs(math.sin(turn))
    low, high = np.nanpercentile(true, [10, 90])
    walls = [_rises(row, profile, float(low), float(high)) for row, profile in zip(true, height, strict=True)]
    widths = np.array([width for row in walls for width in row])
    known = widths[np.isfinite(widths)]
    if not known.size:
        return {"walls": len(widths), "walls_known": 0.0}
    return {
        "walls": len(widths),
        "walls_known": round(known.size / len(widths), 3),
        "wall_px_25_50_75_90_percent": (steeper * np.percentile(known, [25, 50, 75, 90])).round(2).tolist(),
    }


def _rises(true: FloatArray, profile: FloatArray, low: float, high: float) -> list[float]:
    """Return the widths, px along a profile, of 10 to 90 % at each wall of the truth; NaN where heights are unknown."""
    import numpy as np

    step = high - low
    at = np.flatnonzero(np.abs(np.diff(true)) > 0.5 * step)
    widths = []
    for wall in at[(at >= _BEFORE_PX) & (at <= len(true) - _BEHIND_PX)]:
        piece = (profile[wall - _BEFORE_PX : wall + _BEHIND_PX] - low) / step
        widths.append(_rise(piece if true[wall + 1] > true[wall] else piece[::-1]))
    return widths


def _rise(piece: FloatArray) -> float:
    """Return from the last place below 10 % to the next above 90 %, in samples with the parts between them."""
    import numpy as np

    below, above = np.flatnonzero(piece < 0.1), np.flatnonzero(piece > 0.9)
    if not np.isfinite(piece).all() or not below.size or not above.size or above.max() < below.max():
        return math.nan
    start, end = int(below.max()), int(above[above > below.max()].min())
    first = start + (0.1 - piece[start]) / (piece[start + 1] - piece[start])
    last = end - (piece[end] - 0.9) / (piece[end] - piece[end - 1])
    return float(last - first)


def _height(found: HeightError) -> FloatArray:
    height: FloatArray = found.error_um + found.true_um[..., 2]
    return height


_SHAPES: dict[str, Callable[[HeightError, SimulationTruth], dict[str, Any]]] = {
    "step": _step,
    "vickers": _faces,
    "grating": _walls,
}
