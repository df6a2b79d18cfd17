"""Procedural specimens: height fields with relief, steps and fine roughness, from a seed alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy import ndimage

from semscape.compiled import njit
from semscape.simulate.noise import fractal_field
from semscape.types import FloatArray, ImageArray


@dataclass(frozen=True)
class SpecimenSize:
    """How large a piece to make: the field of view it is made for, the extent to fill and the nodes' distance.

    `field_um` is the shorter side of the field of view at zero tilt, to which the relief is scaled; `extent_um` the
    width and height of the whole piece, which must fill every view; `pitch_um` the distance of the nodes.
    """

    field_um: float
    extent_um: tuple[float, float]
    pitch_um: float

    @property
    def shape(self) -> tuple[int, int]:
        """Number of nodes (rows, cols)."""
        return int(np.ceil(self.extent_um[1] / self.pitch_um)) + 1, int(np.ceil(self.extent_um[0] / self.pitch_um)) + 1

    def axes_um(self) -> tuple[FloatArray, FloatArray]:
        """Return x (1, cols), growing with the column, and y (rows, 1), falling with the row; 0 in the middle."""
        rows, cols = self.shape
        x = (np.arange(cols, dtype=np.float64) - (cols - 1) / 2) * self.pitch_um
        y = -(np.arange(rows, dtype=np.float64) - (rows - 1) / 2) * self.pitch_um
        return x[None, :], y[:, None]


@dataclass(frozen=True, eq=False)
class Specimen:
    """A height field over a square grid centred on the world's origin.

    `height_um` (rows, cols) float32: node (row, col) lies at world x = (col - (cols - 1) / 2) pitch and
    y = -(row - (rows - 1) / 2) pitch; between the nodes the surface is bilinear. `texture_seed` fixes the material
    texture, 3D noise at the surface's points.
    """

    name: str
    height_um: ImageArray
    pitch_um: float
    texture_seed: int

    @property
    def grid_from_world(self) -> FloatArray:
        """Affine map (2, 3) from world x, y in um to (col, row)."""
        rows, cols = self.height_um.shape
        scale = 1.0 / self.pitch_um
        return np.array([[scale, 0.0, (cols - 1) / 2], [0.0, -scale, (rows - 1) / 2]])


def _specimen(name: str, height: FloatArray, size: SpecimenSize, rng: np.random.Generator, level: float) -> Specimen:
    """Centre the heights on the eucentric plane: z = 0 at `level` between the lowest and the highest point."""
    zero = height.min() + level * np.ptp(height)
    seed = int(rng.integers(0, 2**31))
    return Specimen(name, np.ascontiguousarray(height - zero, dtype=np.float32), size.pitch_um, seed)


def _roughness(size: SpecimenSize, rms_um: float, coarsest_um: float, rng: np.random.Generator) -> FloatArray:
    return rms_um * fractal_field(size.shape, 0.7, coarsest_um / size.pitch_um, 4.0, rng)


@njit(nogil=True, cache=True)
def _stamp_spheres(height: Any, spheres: Any) -> None:  # pragma: no cover - compiled
    """Raise `height` (rows, cols) to the upper side of spheres (S, 4): col, row, centre's z and radius in cells."""
    rows, cols = height.shape
    for s in range(spheres.shape[0]):
        cx, cy, cz, radius = spheres[s]
        for r in range(max(0, int(cy - radius)), min(rows, int(cy + radius) + 2)):
            for c in range(max(0, int(cx - radius)), min(cols, int(cx + radius) + 2)):
                rest = radius * radius - (c - cx) ** 2 - (r - cy) ** 2
                if rest > 0.0:
                    height[r, c] = max(height[r, c], cz + np.sqrt(rest))


def stamp_spheres(height_um: FloatArray, size: SpecimenSize, centres_um: FloatArray, radii_um: FloatArray) -> None:
    """Raise a height field in place to the upper side of spheres; overhangs drop to vertical walls.

    `centres_um` (S, 3) in the world's frame, `radii_um` (S,).
    """
    rows, cols = size.shape
    pitch = size.pitch_um
    in_cells = np.column_stack(
        [
            centres_um[:, 0] / pitch + (cols - 1) / 2,
            (rows - 1) / 2 - centres_um[:, 1] / pitch,
            centres_um[:, 2] / pitch,
            radii_um / pitch,
        ]
    )
    height_um /= pitch
    _stamp_spheres(height_um, in_cells)
    height_um *= pitch


def fracture(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make a rough fractured surface: self-affine relief, curved steps, and dimples from coarse to fine.

    References
    ----------
    Mandelbrot, Passoja & Paullay, "Fractal character of fracture surfaces of metals", Nature 308 (1984) 721-722,
    doi:10.1038/308721a0: the Hurst exponent is near 0.8.
    """
    cells = size.field_um / size.pitch_um
    height = 0.06 * size.field_um * fractal_field(size.shape, 1.4, 0.9 * cells, 24.0, rng)
    for step in (0.04, 0.025):
        front = fractal_field(size.shape, 1.4, 0.4 * cells, 12.0, rng) - rng.uniform(-0.6, 0.6)
        # The front is a few nodes wide: a wall, not a jump.
        steepness = np.hypot(*np.gradient(ndimage.gaussian_filter(front, 3.0)))
        # It dies out along its length, as a crack that meets no other.
        throw = np.clip(fractal_field(size.shape, 1.6, 0.5 * cells, 12.0, rng), -1.0, 1.0)
        height += 0.5 * step * size.field_um * throw * np.tanh(front / (2.5 * steepness + 1e-4))
    height -= 0.4 * _dimples(size, 0.04, rng)
    height -= 0.25 * _dimples(size, 0.012, rng)
    height += _roughness(size, 0.0004 * size.field_um, 0.03 * size.field_um, rng)
    return _specimen("fracture", height, size, rng, 0.5)


def _dimples(size: SpecimenSize, radius: float, rng: np.random.Generator) -> FloatArray:
    """Return densely packed spherical caps (rows, cols) um; the negative is a field of dimples with sharp ridges.

    `radius` is the median radius of a cap as a share of the field; it varies from place to place and from cap to cap.
    """
    rows, cols = size.shape
    typical = radius * size.field_um
    count = int(2.5 * size.extent_um[0] * size.extent_um[1] / (np.pi * typical**2))
    x = rng.uniform(-0.5, 0.5, count) * size.extent_um[0]
    y = rng.uniform(-0.5, 0.5, count) * size.extent_um[1]
    regions = fractal_field(size.shape, 1.5, 0.3 * size.field_um / size.pitch_um, 16.0, rng)
    at_col = np.clip(x / size.pitch_um + (cols - 1) / 2, 0, cols - 1).astype(np.int64)
    at_row = np.clip((rows - 1) / 2 - y / size.pitch_um, 0, rows - 1).astype(np.int64)
    radii = typical * np.exp(0.35 * regions[at_row, at_col] + 0.35 * rng.standard_normal(count))
    caps = np.full(size.shape, -0.2 * typical)
    stamp_spheres(caps, size, np.column_stack([x, y, -0.7 * radii]), radii)
    return caps


def spheres(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make spheres of several sizes on a plane."""
    radii = size.field_um * rng.uniform(0.03, 0.11, 40)
    span = np.array(size.extent_um) / 2
    kept: list[tuple[float, float, float]] = []
    for radius in np.sort(radii)[::-1]:
        for _ in range(50):
            x, y = rng.uniform(-span, span)
            if all(np.hypot(x - u, y - v) > radius + r for u, v, r in kept):
                kept.append((float(x), float(y), float(radius)))
                break
    table = np.array(kept)
    height = np.zeros(size.shape)
    stamp_spheres(height, size, table[:, [0, 1, 2]], table[:, 2])
    height += _roughness(size, 0.002 * size.field_um, 0.1 * size.field_um, rng)
    return _specimen("spheres", height, size, rng, 0.3)


def grating(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make parallel lines with vertical walls and slightly rough edges, turned by a random angle."""
    x, y = size.axes_um()
    angle = rng.uniform(0, np.pi)
    pitch = size.field_um / 8
    edge = _roughness(size, 0.002 * size.field_um, 0.05 * size.field_um, rng)
    phase = (x * np.cos(angle) + y * np.sin(angle) + edge) / pitch
    height = np.where(phase - np.floor(phase) < 0.5, 0.4 * pitch, 0.0)
    height += _roughness(size, 0.001 * size.field_um, 0.06 * size.field_um, rng)
    return _specimen("grating", height, size, rng, 0.5)


def vickers(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make a Vickers indent: a pyramid of 136 degrees between opposite faces, with pile-up, in a polished surface."""
    x, y = size.axes_um()
    angle = rng.uniform(0, np.pi / 2)
    u, v = x * np.cos(angle) + y * np.sin(angle), -x * np.sin(angle) + y * np.cos(angle)
    slope = np.tan(np.deg2rad(90.0 - 136.0 / 2))
    half_width = 0.32 * size.field_um
    distance = np.maximum(np.abs(u), np.abs(v)) - half_width
    # Pile-up bulges at the middle of each side, where the displaced metal goes.
    bulge = 0.02 * size.field_um * np.exp(-np.maximum(distance, 0) / (0.1 * size.field_um))
    bulge = bulge * np.clip(1.0 - (np.minimum(np.abs(u), np.abs(v)) / half_width) ** 2, 0.0, 1.0)
    height = np.where(distance < 0, slope * distance + bulge * np.exp(distance / (0.02 * size.field_um)), bulge)
    height += _grooves(size, 40, 0.0015 * size.field_um, rng)
    height += _roughness(size, 0.001 * size.field_um, 0.1 * size.field_um, rng)
    return _specimen("vickers", height, size, rng, 0.5)


def scratches(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make a flat, polished surface with scratches and their ridges: little relief, the hardest case for the tilt."""
    height = _grooves(size, 60, 0.008 * size.field_um, rng)
    height += _roughness(size, 0.001 * size.field_um, 0.1 * size.field_um, rng)
    return _specimen("scratches", height, size, rng, 0.7)


def _grooves(size: SpecimenSize, count: int, depth_um: float, rng: np.random.Generator) -> FloatArray:
    """Return V-grooves with a ridge along each side, (rows, cols) um."""
    x, y = size.axes_um()
    height = np.zeros(size.shape)
    reach = float(np.hypot(*size.extent_um)) / 2
    for _ in range(count):
        angle, offset = rng.uniform(0, np.pi), rng.uniform(-reach, reach)
        depth = depth_um * rng.uniform(0.2, 1.0)
        across = np.abs(x * np.cos(angle) + y * np.sin(angle) - offset) / (1.5 * depth)
        height += depth * (-np.clip(1.0 - across, 0.0, 1.0) + 0.3 * np.exp(-(((across - 1.3) / 0.4) ** 2)))
    return height


def pollen(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make a spiny sphere, half sunk in a rough stub, as a height map seen from above."""
    radius = 0.27 * size.field_um
    count = 150
    index = np.arange(count) + 0.5
    z = 1.0 - index / count * 1.15  # a Fibonacci lattice down to a little below the equator
    azimuth = np.pi * (1.0 + 5.0**0.5) * index + rng.uniform(0, 2 * np.pi)
    ring = np.sqrt(1.0 - z**2)
    direction = np.column_stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z])
    direction += 0.04 * rng.standard_normal(direction.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along = np.linspace(0.97, 1.16, 24)
    thickness = radius * np.interp(along, [0.97, 1.02, 1.16], [0.060, 0.034, 0.005])
    centres = (direction[:, None, :] * (radius * along)[None, :, None]).reshape(-1, 3)
    centres = np.vstack([np.zeros((1, 3)), centres])
    radii = np.concatenate([[radius], np.tile(thickness, count)])
    height = -0.25 * radius + _roughness(size, 0.009 * size.field_um, 0.3 * size.field_um, rng)
    stamp_spheres(height, size, centres, radii)
    height += _roughness(size, 0.0016 * size.field_um, 0.06 * size.field_um, rng)
    return _specimen("pollen", height, size, rng, 0.4)


def face(size: SpecimenSize, rng: np.random.Generator) -> Specimen:
    """Make a face-like relief: an ellipsoid with brow, nose, eyes, lips and chin, on a plane."""
    x, y = size.axes_um()
    u, v = x / size.field_um, y / size.field_um

    def bump(height: float, cu: float, cv: float, su: float, sv: float) -> FloatArray:
        out: FloatArray = height * np.exp(-(((u - cu) / su) ** 2) - ((v - cv) / sv) ** 2)
        return out

    head = 0.20 * np.sqrt(np.clip(1.0 - (u / 0.34) ** 2 - (v / 0.45) ** 2, 0.0, 1.0))
    features = (
        bump(0.055, 0.0, 0.0, 0.045, 0.10)
        + bump(0.030, 0.0, -0.06, 0.055, 0.04)
        + bump(0.022, 0.0, 0.13, 0.20, 0.035)
        + bump(0.020, 0.0, -0.165, 0.075, 0.018)
        + bump(0.018, 0.0, -0.20, 0.060, 0.018)
        + bump(0.025, 0.0, -0.29, 0.07, 0.05)
    )
    for side in (-1.0, 1.0):
        features = (
            features - bump(0.030, side * 0.115, 0.08, 0.055, 0.030) + bump(0.016, side * 0.115, 0.08, 0.03, 0.02)
        )
        features = features + bump(0.018, side * 0.17, -0.05, 0.07, 0.07)
    height = size.field_um * (head + features * np.clip(head / 0.1, 0.0, 1.0))
    height = height + _roughness(size, 0.0022 * size.field_um, 0.06 * size.field_um, rng)
    return _specimen("face", height, size, rng, 0.5)


SPECIMENS: Mapping[str, Callable[[SpecimenSize, np.random.Generator], Specimen]] = MappingProxyType(
    {
        "fracture": fracture,
        "spheres": spheres,
        "grating": grating,
        "vickers": vickers,
        "scratches": scratches,
        "pollen": pollen,
        "face": face,
    }
)
