"""Secondary and backscattered electrons from points of a surface (Reimer, Scanning Electron Microscopy, 1998)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import ndimage

from semscape.compiled import njit
from semscape.simulate.noise import octave_noise
from semscape.simulate.presets import SimulationOptions
from semscape.types import ImageArray

TEXTURE_OCTAVES = 3
_SKY_DIRECTIONS = 8


@njit(nogil=True, cache=True)
def _open_sky(height: Any, pitch_um: float, reach: int, out: Any) -> None:  # pragma: no cover - compiled
    rows, cols = height.shape
    for r in range(rows):
        for c in range(cols):
            total = 0.0
            for k in range(_SKY_DIRECTIONS):
                angle = 2.0 * math.pi * k / _SKY_DIRECTIONS
                ux, uy = math.cos(angle), math.sin(angle)
                steepest, distance = 0.0, 1.0
                while distance <= reach:
                    x, y = int(c + ux * distance + 0.5), int(r + uy * distance + 0.5)
                    if x < 0 or y < 0 or x >= cols or y >= rows:
                        break
                    steepest = max(steepest, (height[y, x] - height[r, c]) / (distance * pitch_um))
                    distance *= 1.5
                total += 1.0 / (1.0 + steepest * steepest)
            out[r, c] = total / _SKY_DIRECTIONS


def open_sky(height_um: ImageArray, pitch_um: float, reach_um: float) -> ImageArray:
    """Return the share of the sky (rows, cols) that each point of a height map sees, 1 on open ground.

    The mean over azimuths of cos^2 of the horizon's elevation within `reach_um`; it stands for the electrons that
    leave a cavity. A coarser grid is enough: `height_um` (rows, cols) has nodes every `pitch_um`.
    """
    out = np.empty(height_um.shape, dtype=np.float32)
    _open_sky(height_um, pitch_um, max(1, int(reach_um / pitch_um)), out)
    return out


def surface_layers(
    height_um: ImageArray, pitch_um: float, sky_reach_px: float, options: SimulationOptions
) -> ImageArray:
    """Precompute what the signal needs of a height field alone.

    Parameters
    ----------
    height_um : (rows, cols) float32 array
        Heights, NaN where there is none; rows run along -y.
    pitch_um : float
        Distance of the nodes.
    sky_reach_px : float
        How far a wall shadows, in px of the image.
    options : SimulationOptions
        `edge_px` and the pixel size are used.

    Returns
    -------
    (rows, cols, 5) float32 array
        Normal (not of unit length), thinness of convex edges in [0, 1], share of open sky in [0, 1].
    """
    unknown = np.isnan(height_um)
    if unknown.any():
        nearest = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
        height_um = height_um[tuple(nearest)]
    layers = np.empty((*height_um.shape, 5), dtype=np.float32)
    along_rows, along_cols = np.gradient(height_um, pitch_um)
    layers[..., 0], layers[..., 1], layers[..., 2] = -along_cols, along_rows, 1.0
    escape_um = max(options.edge_px * options.pixel_size_um, pitch_um)
    mean = ndimage.gaussian_filter(height_um, escape_um / pitch_um, mode="nearest", truncate=3.0)
    layers[..., 3] = np.clip((height_um - mean) / escape_um, 0.0, 1.0)
    coarse = np.ascontiguousarray(height_um[::2, ::2])
    sky = open_sky(coarse, 2 * pitch_um, sky_reach_px * options.pixel_size_um)
    rows, cols = (np.arange(n, dtype=np.float32) / 2 for n in height_um.shape)
    layers[..., 4] = ndimage.map_coordinates(
        sky, np.meshgrid(rows, cols, indexing="ij"), order=1, mode="nearest", output=np.float32
    )
    return layers


@njit(nogil=True, cache=True)
def secondary_yield(cos_theta: float, saturation: float) -> float:  # pragma: no cover - compiled
    """Return the yield relative to normal incidence, (1 + eps) / (cos(theta) + eps)."""
    return (1.0 + saturation) / (max(cos_theta, 0.02) + saturation)


@njit(nogil=True, cache=True)
def backscatter_yield(cos_theta: float, atomic_number: float) -> float:  # pragma: no cover - compiled
    """Return the yield relative to normal incidence, ((1 + cos(theta)) / 2)^(-9 / sqrt(Z)).

    Arnal, Verdier & Vincensini, C. R. Acad. Sci. 268 (1969) 1526; Reimer 1998, equation 4.15.
    """
    return math.pow((1.0 + max(cos_theta, 0.0)) / 2.0, -9.0 / math.sqrt(atomic_number))


@njit(nogil=True, cache=True)
def apply_material(
    position: Any, attributes: Any, texture: float, wavelength: float, bump: float, seed: int, factor: Any
) -> None:  # pragma: no cover - compiled
    """Turn the normals by the material's fine bumps, and give the factor by which its texture changes the yield.

    Parameters
    ----------
    position : (N, 3) float array
        Points in um in the world's frame, NaN for none: the texture belongs to the surface.
    attributes : (N, 5) float array
        As of `Surface.attributes`; the normals are changed in place.
    texture, wavelength, bump : float
        Relative rms, coarsest wavelength in um, rms slope of the bumps.
    seed : int
        Seed of the texture.
    factor : (N,) float array
        Output, 0 where there is no surface.
    """
    noise, scratch = np.zeros(4), np.zeros(4)
    for n in range(position.shape[0]):
        x, y, z = position[n, 0] / wavelength, position[n, 1] / wavelength, position[n, 2] / wavelength
        if math.isnan(z):
            factor[n] = 0.0
            continue
        octave_noise(x, y, z, TEXTURE_OCTAVES, seed, scratch, noise)
        nx, ny, nz = attributes[n, 0], attributes[n, 1], attributes[n, 2]
        # Tilt the normal against the part of the gradient that lies in the surface.
        along = noise[1] * nx + noise[2] * ny + noise[3] * nz
        nx -= bump * (noise[1] - along * nx)
        ny -= bump * (noise[2] - along * ny)
        nz -= bump * (noise[3] - along * nz)
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        attributes[n, 0], attributes[n, 1], attributes[n, 2] = nx / norm, ny / norm, nz / norm
        factor[n] = max(0.0, 1.0 + texture * noise[0])


@njit(nogil=True, cache=True)
def secondary_signal(
    attributes: Any, factor: Any, beam: Any, to_detector: Any, strengths: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Compute the signal of secondary electrons.

    Parameters
    ----------
    attributes : (N, 5) float array
        Unit normal, thinness, open sky.
    factor : (N,) float array
        Factor of the texture, 0 where there is no surface.
    beam : (1, 3) or (N, 3) float array
        Unit vectors along the beam, away from the source.
    to_detector : (3,) float array
        Unit vector to the detector in the world's frame.
    strengths : (4,) float array
        Yield's saturation, gain of edges, detector asymmetry, shadowing in cavities.
    out : (N,) float array
        Output: 1 for a smooth level open surface in front of an isotropic detector.
    """
    saturation, edge_gain, asymmetry, cavity = strengths
    for n in range(len(factor)):
        if factor[n] == 0.0:
            out[n] = 0.0
            continue
        m = min(n, beam.shape[0] - 1)
        nx, ny, nz = attributes[n, 0], attributes[n, 1], attributes[n, 2]
        value = factor[n] * secondary_yield(-nx * beam[m, 0] - ny * beam[m, 1] - nz * beam[m, 2], saturation)
        value *= 1.0 + edge_gain * attributes[n, 3]
        value *= 1.0 - cavity * (1.0 - attributes[n, 4])
        value *= max(0.0, 1.0 + asymmetry * (nx * to_detector[0] + ny * to_detector[1] + nz * to_detector[2]))
        out[n] = value


@njit(nogil=True, cache=True)
def backscattered_signal(
    attributes: Any, factor: Any, beam: Any, to_segment: Any, level: float, atomic_number: float, out: Any
) -> None:  # pragma: no cover - compiled
    """Compute the signal of backscattered electrons in one segment: the yield, shared out by Lambert's cosine law.

    Parameters as of `secondary_signal`; `to_segment` (3,) is the mean direction over the segment in the world's
    frame, `level` its vertical part in the lab. `out` (N,) is 1 for a smooth level surface at zero tilt.
    """
    for n in range(len(factor)):
        m = min(n, beam.shape[0] - 1)
        nx, ny, nz = attributes[n, 0], attributes[n, 1], attributes[n, 2]
        towards = max(0.0, nx * to_segment[0] + ny * to_segment[1] + nz * to_segment[2]) / level
        cosine = -nx * beam[m, 0] - ny * beam[m, 1] - nz * beam[m, 2]
        out[n] = factor[n] * backscatter_yield(cosine, atomic_number) * towards if factor[n] > 0.0 else 0.0
