"""Rays against a height field: the first hit, exact for the bilinear surface between the grid's nodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semscape.types import FloatArray


@njit(nogil=True, cache=True)
def cast_rays(
    height: Any, origin: Any, slope: Any, z_top: float, z_bottom: float, hit: Any
) -> None:  # pragma: no cover - compiled
    """Find where each ray first meets the surface.

    The ray n passes the level z at the grid position origin[n] + slope[n] z and comes from z = +infinity. It walks
    from cell to cell (Amanatides & Woo 1987); in a cell the bilinear surface along the ray is a parabola.

    Parameters
    ----------
    height : (rows, cols) float32 array
        Heights in um at the nodes.
    origin : (N, 2) float array
        Grid position (col, row) of each ray at z = 0.
    slope : (N, 2) or (1, 2) float array
        Change of the grid position per um of z; one row serves parallel rays.
    z_top, z_bottom : float
        Bounds of the heights in um.
    hit : (N, 3) float array
        Output: col, row and z in um of the first hit, NaN where a ray leaves the grid.
    """
    rows, cols = height.shape
    for n in range(origin.shape[0]):
        m = min(n, slope.shape[0] - 1)
        hit[n, 0] = hit[n, 1] = hit[n, 2] = np.nan
        # t is the descent below z_top; the position is p + v t.
        vx, vy = -slope[m, 0], -slope[m, 1]
        px, py = origin[n, 0] + slope[m, 0] * z_top, origin[n, 1] + slope[m, 1] * z_top
        t, t_end = 0.0, z_top - z_bottom + 1e-6 * (1.0 + z_top - z_bottom)
        for p, v, upper in ((px, vx, cols - 1.0), (py, vy, rows - 1.0)):
            if abs(v) < 1e-12:
                if p < 0.0 or p > upper:
                    t_end = -1.0
            else:
                t_low, t_high = -p / v, (upper - p) / v
                t = max(t, min(t_low, t_high))
                t_end = min(t_end, max(t_low, t_high))
        if t > t_end:
            continue
        ix = min(max(math.floor(px + vx * t), 0), cols - 2)
        iy = min(max(math.floor(py + vy * t), 0), rows - 2)
        step_x, step_y = (1 if vx > 0 else -1), (1 if vy > 0 else -1)
        dt_x = 1.0 / abs(vx) if abs(vx) >= 1e-12 else np.inf
        dt_y = 1.0 / abs(vy) if abs(vy) >= 1e-12 else np.inf
        next_x = (ix + (1 if vx > 0 else 0) - px) / vx if dt_x < np.inf else np.inf
        next_y = (iy + (1 if vy > 0 else 0) - py) / vy if dt_y < np.inf else np.inf
        while True:
            t_next = min(next_x, next_y, t_end)
            a, b = height[iy, ix], height[iy, ix + 1]
            c, d = height[iy + 1, ix], height[iy + 1, ix + 1]
            if z_top - t_next <= max(a, b, c, d):
                x, y = px + vx * t - ix, py + vy * t - iy
                twist = a - b - c + d
                # Height of the ray above the surface at t + u: f0 + f1 u + f2 u^2.
                f0 = z_top - t - (a + (b - a) * x + (c - a) * y + twist * x * y)
                f1 = -1.0 - (b - a) * vx - (c - a) * vy - twist * (x * vy + y * vx)
                f2 = -twist * vx * vy
                u = np.inf
                if f0 <= 0.0:
                    u = 0.0
                else:
                    discriminant = f1 * f1 - 4.0 * f2 * f0
                    if discriminant >= 0.0:
                        q = -0.5 * (f1 + math.copysign(math.sqrt(discriminant), f1))
                        for root in (f0 / q if q != 0.0 else np.inf, q / f2 if f2 != 0.0 else np.inf):
                            if 0.0 <= root < u:
                                u = root
                if t + u <= t_next + 1e-9:
                    hit[n, 0] = px + vx * (t + u)
                    hit[n, 1] = py + vy * (t + u)
                    hit[n, 2] = z_top - t - u
                    break
            if t_next >= t_end:
                break
            t = t_next
            if next_x <= next_y:
                ix += step_x
                next_x += dt_x
            else:
                iy += step_y
                next_y += dt_y
            if ix < 0 or iy < 0 or ix > cols - 2 or iy > rows - 2:
                break


@njit(nogil=True, cache=True)
def sample_bilinear(grid: Any, position: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Sample `grid` (rows, cols) at `position` (N, 2) = (col, row) into `out` (N,); NaN outside."""
    rows, cols = grid.shape
    for n in range(position.shape[0]):
        x, y = position[n, 0], position[n, 1]
        if not (x >= 0.0 and y >= 0.0 and x <= cols - 1 and y <= rows - 1):
            out[n] = np.nan
            continue
        ix, iy = min(int(x), cols - 2), min(int(y), rows - 2)
        fx, fy = x - ix, y - iy
        top = (1.0 - fx) * grid[iy, ix] + fx * grid[iy, ix + 1]
        bottom = (1.0 - fx) * grid[iy + 1, ix] + fx * grid[iy + 1, ix + 1]
        out[n] = (1.0 - fy) * top + fy * bottom


def rays_of_pixels(
    matrix: FloatArray, translation_px: FloatArray, grid_from_world: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn a parallel camera into rays in grid coordinates.

    Parameters
    ----------
    matrix : (2, 3) float array
        px per um, as of `geometry.cameras.camera_matrices`.
    translation_px : (2,) float array
        Image of the world's origin.
    grid_from_world : (2, 3) float array
        Affine map of the world's (x, y) in um to (col, row).

    Returns
    -------
    linear : (2, 2) float array
        The ray of pixel x passes z = 0 at the grid position linear @ x + offset.
    offset : (2,) float array
        See `linear`.
    slope : (2,) float array
        Change of the grid position per um of z.
    """
    to_grid: NDArray[np.float64] = grid_from_world[:, :2] @ np.linalg.inv(matrix[:, :2])
    return to_grid, grid_from_world[:, 2] - to_grid @ translation_px, -to_grid @ matrix[:, 2]
