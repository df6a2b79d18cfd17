"""The secondary-electron signal at points of a surface (Reimer, Scanning Electron Microscopy, 1998, chapter 4)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from scipy import ndimage

from semscape.simulate.noise import octave_noise
from semscape.simulate.presets import SimulationOptions
from semscape.types import FloatArray, ImageArray

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


def surface_layers(height_um: ImageArray, pitch_um: float, options: SimulationOptions) -> ImageArray:
    """Precompute what the signal needs of the surface alone.

    Parameters
    ----------
    height_um : (rows, cols) float32 array
        Heights; rows run along -y.
    pitch_um : float
        Distance of the nodes.
    options : SimulationOptions
        `edge_px` and the pixel size are used.

    Returns
    -------
    (rows, cols, 4) float32 array
        Slopes dz/dx and dz/dy, thinness of convex edges in [0, 1], share of open sky in [0, 1].
    """
    layers = np.empty((*height_um.shape, 4), dtype=np.float32)
    along_rows, along_cols = np.gradient(height_um, pitch_um)
    layers[..., 0], layers[..., 1] = along_cols, -along_rows
    escape_um = max(options.edge_px * options.pixel_size_um, pitch_um)
    mean = ndimage.gaussian_filter(height_um, escape_um / pitch_um, mode="nearest", truncate=3.0)
    layers[..., 2] = np.clip((height_um - mean) / escape_um, 0.0, 1.0)
    coarse = np.ascontiguousarray(height_um[::2, ::2])
    sky = open_sky(coarse, 2 * pitch_um, 64 * options.pixel_size_um)
    rows, cols = (np.arange(n, dtype=np.float32) / 2 for n in height_um.shape)
    layers[..., 3] = ndimage.map_coordinates(
        sky, np.meshgrid(rows, cols, indexing="ij"), order=1, mode="nearest", output=np.float32
    )
    return layers


@njit(nogil=True, cache=True)
def secondary_yield(cos_theta: float, saturation: float) -> float:  # pragma: no cover - compiled
    """Return the yield relative to normal incidence, (1 + eps) / (cos(theta) + eps)."""
    return (1.0 + saturation) / (max(cos_theta, 0.02) + saturation)


@njit(nogil=True, cache=True)
def shade(
    hit: Any, xy_um: Any, layers: Any, to_source: Any, to_detector: Any, strengths: Any, seed: int, out: Any
) -> None:  # pragma: no cover - compiled
    """Compute the signal at each hit point.

    Parameters
    ----------
    hit : (N, 3) float array
        Grid col, row and height in um, NaN where there is no surface.
    xy_um : (N, 2) float array
        World position of the hits.
    layers : (rows, cols, 4) float32 array
        As of `surface_layers`.
    to_source, to_detector : (3,) float array
        Unit vectors in the specimen's world frame.
    strengths : (7,) float array
        As of `strengths_of`.
    seed : int
        Seed of the material texture.
    out : (N,) float array
        Output: signal, 1 for a smooth level open surface in front of an isotropic detector; 0 without a surface.
    """
    rows, cols = layers.shape[:2]
    saturation, edge_gain, asymmetry, cavity, texture, wavelength, bump = strengths
    noise, scratch = np.zeros(4), np.zeros(4)
    layer = np.empty(4)
    for n in range(hit.shape[0]):
        x, y, z = hit[n, 0], hit[n, 1], hit[n, 2]
        if math.isnan(z):
            out[n] = 0.0
            continue
        ix, iy = min(max(int(x), 0), cols - 2), min(max(int(y), 0), rows - 2)
        fx, fy = x - ix, y - iy
        for i in range(4):
            layer[i] = (1.0 - fy) * ((1.0 - fx) * layers[iy, ix, i] + fx * layers[iy, ix + 1, i]) + fy * (
                (1.0 - fx) * layers[iy + 1, ix, i] + fx * layers[iy + 1, ix + 1, i]
            )
        nx, ny, nz = -layer[0], -layer[1], 1.0
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / norm, ny / norm, nz / norm
        if texture > 0.0 or bump > 0.0:
            octave_noise(
                xy_um[n, 0] / wavelength,
                xy_um[n, 1] / wavelength,
                z / wavelength,
                TEXTURE_OCTAVES,
                seed,
                scratch,
                noise,
            )
            # Tilt the normal against the part of the gradient that lies in the surface.
            along = noise[1] * nx + noise[2] * ny + noise[3] * nz
            nx -= bump * (noise[1] - along * nx)
            ny -= bump * (noise[2] - along * ny)
            nz -= bump * (noise[3] - along * nz)
            norm = math.sqrt(nx * nx + ny * ny + nz * nz)
            nx, ny, nz = nx / norm, ny / norm, nz / norm
        value = secondary_yield(nx * to_source[0] + ny * to_source[1] + nz * to_source[2], saturation)
        value *= 1.0 + edge_gain * layer[2]
        value *= 1.0 - cavity * (1.0 - layer[3])
        value *= max(0.0, 1.0 + asymmetry * (nx * to_detector[0] + ny * to_detector[1] + nz * to_detector[2]))
        out[n] = value * max(0.0, 1.0 + texture * noise[0])


def strengths_of(options: SimulationOptions) -> FloatArray:
    """Return the signal's strengths (7,) in the order of `shade`; the texture's wavelength is in um."""
    return np.array(
        [
            options.yield_saturation,
            options.edge_gain,
            options.detector_asymmetry,
            options.cavity,
            options.texture,
            max(options.texture_px, 1e-3) * options.pixel_size_um,
            options.texture_bump,
        ]
    )
