"""Procedural noise: fractal fields over a grid and gradient noise in space, both fixed by a seed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import fft

from semscape.compiled import njit
from semscape.types import FloatArray


def fractal_field(
    shape: tuple[int, int], hurst: float, coarsest: float, finest: float, rng: np.random.Generator
) -> FloatArray:
    """Return a self-affine Gaussian random field by spectral synthesis.

    Parameters
    ----------
    shape : (rows, cols)
        Size of the grid.
    hurst : float
        Hurst exponent: the power spectral density falls as f^-(2 hurst + 2).
    coarsest, finest : float
        Wavelengths in grid cells; the spectrum is flat beyond the first and rolls off smoothly below the second.
    rng : numpy.random.Generator
        Source of the phases and amplitudes.

    Returns
    -------
    (rows, cols) float array
        Zero mean, unit rms.
    """
    rows, cols = (fft.next_fast_len(n, real=True) for n in shape)
    spectrum = fft.rfft2(rng.standard_normal((rows, cols)))
    frequency = np.hypot(fft.fftfreq(rows)[:, None], fft.rfftfreq(cols)[None, :])
    spectrum *= (frequency**2 + coarsest**-2) ** (-(hurst + 1) / 2) * np.exp(-((frequency * finest) ** 2) / 2)
    spectrum[0, 0] = 0.0
    field: FloatArray = fft.irfft2(spectrum, s=(rows, cols))[: shape[0], : shape[1]]
    field = (field - field.mean()) / field.std()
    return field


@njit(nogil=True, cache=True)
def _corner(ix: int, iy: int, iz: int, seed: int) -> int:  # pragma: no cover - compiled
    mask = np.uint64(0xFFFFFFFF)
    h = np.uint64(seed) & mask
    for part in (ix, iy, iz):
        h = (h ^ (np.uint64(part) & mask)) * np.uint64(0x9E3779B1) & mask
        h ^= h >> np.uint64(15)
    h = h * np.uint64(0x85EBCA77) & mask
    return int((h ^ (h >> np.uint64(13))) & np.uint64(15))


_DIAGONALS = np.array(
    [
        *((x, y, 0.0) for x in (1.0, -1.0) for y in (1.0, -1.0)),
        *((x, 0.0, z) for x in (1.0, -1.0) for z in (1.0, -1.0)),
        *((0.0, y, z) for y in (1.0, -1.0) for z in (1.0, -1.0)),
        *((1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (0.0, -1.0, 1.0), (0.0, -1.0, -1.0)),
    ]
)


@njit(nogil=True, cache=True)
def gradient_noise(x: float, y: float, z: float, seed: int, out: Any) -> None:  # pragma: no cover - compiled
    """Write improved gradient noise (Perlin 2002, doi:10.1145/566654.566636) at a point into `out` (4,).

    out[0] is the value, of rms about 0.25, and out[1:] its exact gradient; the lattice has unit cells.
    """
    ix, iy, iz = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - ix, y - iy, z - iz
    ux, uy, uz = (
        fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0),
        fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0),
        fz * fz * fz * (fz * (fz * 6.0 - 15.0) + 10.0),
    )
    dx, dy, dz = (
        30.0 * fx * fx * (fx - 1.0) * (fx - 1.0),
        30.0 * fy * fy * (fy - 1.0) * (fy - 1.0),
        30.0 * fz * fz * (fz - 1.0) * (fz - 1.0),
    )
    out[0] = out[1] = out[2] = out[3] = 0.0
    for corner in range(8):
        cx, cy, cz = corner & 1, (corner >> 1) & 1, corner >> 2
        k = _corner(ix + cx, iy + cy, iz + cz, seed)
        gx, gy, gz = _DIAGONALS[k, 0], _DIAGONALS[k, 1], _DIAGONALS[k, 2]
        value = gx * (fx - cx) + gy * (fy - cy) + gz * (fz - cz)
        wx = ux if cx else 1.0 - ux
        wy = uy if cy else 1.0 - uy
        wz = uz if cz else 1.0 - uz
        out[0] += wx * wy * wz * value
        out[1] += wx * wy * wz * gx + (dx if cx else -dx) * wy * wz * value
        out[2] += wx * wy * wz * gy + wx * (dy if cy else -dy) * wz * value
        out[3] += wx * wy * wz * gz + wx * wy * (dz if cz else -dz) * value


@njit(nogil=True, cache=True)
def octave_noise(
    x: float, y: float, z: float, octaves: int, seed: int, scratch: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Sum octaves of gradient noise, each of half the wavelength, into `out` (4,): value and gradient of rms near 1.

    The values of all octaves have the same amplitude, the gradients (per radian of their own octave's phase, so that
    fine bumps do not dominate) too.
    """
    out[0] = out[1] = out[2] = out[3] = 0.0
    frequency = 1.0
    for octave in range(octaves):
        gradient_noise(x * frequency, y * frequency, z * frequency, seed + octave, scratch)
        for i in range(4):
            out[i] += scratch[i]
        frequency *= 2.0
    scale = 4.0 / math.sqrt(octaves)
    out[0] *= scale
    for i in range(1, 4):
        out[i] *= scale / 4.0
