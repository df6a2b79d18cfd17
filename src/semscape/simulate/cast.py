"""Rays against a height field: the first hit, exact for the bilinear surface between the grid's nodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from semscape.compiled import njit
from semscape.types import ImageArray

BLOCK = 16  # cells along each side of a block whose highest point is known
_PARALLEL = 1e-12


def block_tops(height: ImageArray) -> ImageArray:
    """Return the highest node of each block of `BLOCK` x `BLOCK` cells; -inf where a block has no known height.

    Neighbouring blocks share the nodes between them.
    """
    rows, cols = (-(-(n - 1) // BLOCK) for n in height.shape)
    padded = np.full((rows * BLOCK + 1, cols * BLOCK + 1), -np.inf, dtype=np.float32)
    padded[: height.shape[0], : height.shape[1]] = np.where(np.isnan(height), -np.inf, height)
    starts = [np.arange(n) * BLOCK for n in (rows, cols)]
    tops = np.maximum.reduceat(np.maximum.reduceat(padded[:-1, :-1], starts[0], axis=0), starts[1], axis=1)
    below = np.maximum.reduceat(padded[BLOCK::BLOCK, :-1], starts[1], axis=1)
    right = np.maximum.reduceat(padded[:-1, BLOCK::BLOCK], starts[0], axis=0)
    corner = padded[BLOCK::BLOCK, BLOCK::BLOCK]
    highest: ImageArray = np.maximum.reduce([tops, below, right, corner])
    return highest


@njit(nogil=True, cache=True)
def cast_rays(
    height: Any, tops: Any, origin: Any, slope: Any, z_top: float, z_bottom: float, hit: Any
) -> None:  # pragma: no cover - compiled
    """Find where each ray first meets the surface.

    The ray n passes the level z at the grid position origin[n] + slope[n] z and comes from z = +infinity. It walks
    from block to block, and in each block that it may meet from cell to cell (Amanatides & Woo 1987,
    doi:10.2312/egtp.19871000).

    Parameters
    ----------
    height : (rows, cols) float32 array
        Heights in um at the nodes; a cell with a NaN at a corner is a hole.
    tops : float32 array
        As of `block_tops`.
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
    depth = z_top - z_bottom + 1e-6 * (1.0 + z_top - z_bottom)
    for n in range(origin.shape[0]):
        m = min(n, slope.shape[0] - 1)
        hit[n, 0] = hit[n, 1] = hit[n, 2] = np.nan
        # t is the descent below z_top; the position is p + v t.
        vx, vy = -slope[m, 0], -slope[m, 1]
        px, py = origin[n, 0] + slope[m, 0] * z_top, origin[n, 1] + slope[m, 1] * z_top
        t, t_end = 0.0, depth
        for p, v, upper in ((px, vx, cols - 1.0), (py, vy, rows - 1.0)):
            if abs(v) < _PARALLEL:
                if not 0.0 <= p <= upper:
                    t_end = -1.0
            else:
                t_low, t_high = -p / v, (upper - p) / v
                t = max(t, min(t_low, t_high))
                t_end = min(t_end, max(t_low, t_high))
        if not t <= t_end:  # NaN counts as a miss
            continue
        bx = min(max(int((px + vx * t) / BLOCK), 0), tops.shape[1] - 1)
        by = min(max(int((py + vy * t) / BLOCK), 0), tops.shape[0] - 1)
        next_x, dt_x = _first_border(px, vx, bx, BLOCK)
        next_y, dt_y = _first_border(py, vy, by, BLOCK)
        while True:
            t_next = min(next_x, next_y, t_end)
            if z_top - t_next <= tops[by, bx]:
                met = _in_block(height, bx * BLOCK, by * BLOCK, px, py, vx, vy, z_top, t, t_next)
                if met < np.inf:
                    hit[n, 0] = px + vx * met
                    hit[n, 1] = py + vy * met
                    hit[n, 2] = z_top - met
                    break
            if t_next >= t_end:
                break
            t = max(t, t_next)
            if next_x <= next_y:
                bx += 1 if vx > 0 else -1
                next_x += dt_x
            else:
                by += 1 if vy > 0 else -1
                next_y += dt_y
            if bx < 0 or by < 0 or bx >= tops.shape[1] or by >= tops.shape[0]:
                break


@njit(nogil=True, cache=True)
def _first_border(p: float, v: float, cell: int, size: float) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return when a ray leaves a cell along one axis, and how long it takes to cross one."""
    if abs(v) < _PARALLEL:
        return np.inf, np.inf
    return ((cell + (1.0 if v > 0 else 0.0)) * size - p) / v, size / abs(v)


@njit(nogil=True, cache=True)
def _in_block(
    height: Any, x0: int, y0: int, px: float, py: float, vx: float, vy: float, z_top: float, t: float, t_end: float
) -> float:  # pragma: no cover - compiled
    """Return the descent at which a ray first meets the block with the corner (x0, y0) between t and t_end, or inf."""
    last_x, last_y = min(x0 + BLOCK, height.shape[1] - 1) - 1, min(y0 + BLOCK, height.shape[0] - 1) - 1
    ix = min(max(math.floor(px + vx * t), x0), last_x)
    iy = min(max(math.floor(py + vy * t), y0), last_y)
    next_x, dt_x = _first_border(px, vx, ix, 1.0)
    next_y, dt_y = _first_border(py, vy, iy, 1.0)
    while True:
        t_next = min(next_x, next_y, t_end)
        a, b = height[iy, ix], height[iy, ix + 1]
        c, d = height[iy + 1, ix], height[iy + 1, ix + 1]
        if z_top - t_next <= max(a, b, c, d):  # never where one of them is NaN, for then f0 below is
            met = t + _to_patch(a, b, c, d, px + vx * t - ix, py + vy * t - iy, z_top - t, vx, vy)
            if met <= t_next + 1e-9:
                return met
        if t_next >= t_end:
            return np.inf
        t = max(t, t_next)
        if next_x <= next_y:
            ix += 1 if vx > 0 else -1
            next_x += dt_x
        else:
            iy += 1 if vy > 0 else -1
            next_y += dt_y
        if ix < x0 or iy < y0 or ix > last_x or iy > last_y:
            return np.inf


@njit(nogil=True, cache=True)
def _to_patch(
    a: float, b: float, c: float, d: float, x: float, y: float, z: float, vx: float, vy: float
) -> float:  # pragma: no cover - compiled
    """Return how far a ray at (x, y, z) in a cell must descend to its bilinear surface, inf where it does not meet it.

    The height of the ray above the surface is a parabola f0 + f1 u + f2 u^2 in the descent u.
    """
    twist = a - b - c + d
    f0 = z - (a + (b - a) * x + (c - a) * y + twist * x * y)
    f1 = -1.0 - (b - a) * vx - (c - a) * vy - twist * (x * vy + y * vx)
    f2 = -twist * vx * vy
    if math.isnan(f0):
        return np.inf
    if f0 <= 0.0:
        return 0.0
    discriminant = f1 * f1 - 4.0 * f2 * f0
    if discriminant < 0.0:
        return np.inf
    q = -0.5 * (f1 + math.copysign(math.sqrt(discriminant), f1))
    nearest = np.inf
    for root in (f0 / q if q != 0.0 else np.inf, q / f2 if f2 != 0.0 else np.inf):
        if 0.0 <= root < nearest:
            nearest = root
    return nearest


@njit(nogil=True, cache=True)
def sample_bilinear(grid: Any, position: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Sample `grid` (rows, cols, K) at `position` (N, 2) = (col, row) into `out` (N, K), level past its border."""
    rows, cols = grid.shape[:2]
    for n in range(position.shape[0]):
        x, y = min(max(position[n, 0], 0.0), cols - 1.0), min(max(position[n, 1], 0.0), rows - 1.0)
        ix, iy = min(int(x), cols - 2), min(int(y), rows - 2)
        fx, fy = x - ix, y - iy
        for k in range(grid.shape[2]):
            top = (1.0 - fx) * grid[iy, ix, k] + fx * grid[iy, ix + 1, k]
            bottom = (1.0 - fx) * grid[iy + 1, ix, k] + fx * grid[iy + 1, ix + 1, k]
            out[n, k] = (1.0 - fy) * top + fy * bottom
