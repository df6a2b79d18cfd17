"""A preconditioner for surfaces that are smooth over many pixels: changes on coarser grids beside those of pixels.

Conjugate gradients move a surface by about a pixel's reach in a step, so a plane that is tilted wrongly takes hundreds.
Here a residual is answered on a pyramid of grids at once, every one half as fine as the one before, whose functions are
cubic B-splines: a sum, over all functions, of the residual in them over the system's diagonal there (Bramble, Pasciak &
Xu 1990). The diagonals come from the means of stiffness and weights, so they follow the smoothness of every place.

Nodes stand on every second pixel, from one before the first to one beyond the last.

References: Bramble, Pasciak & Xu 1990, doi:10.1090/S0025-5718-1990-1023042-6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.types import FloatArray

Plane = NDArray[np.float32]

_LEAST_SIDE = 12
_LEAST_DIAGONAL = 1e-9
# Functions of a coarser grid overlap, pixels do not; those across a cut, which nothing holds together, disturb.
_SHARE_OF_COARSER = 0.1
# A function of a grid at the nodes of the next finer one.
_SPLINE = (0.125, 0.5, 0.75, 0.5, 0.125)


def inverse_diagonals(stiffness: Plane, weights: tuple[Plane, Plane, Plane], diagonal: Plane, most: int) -> list[Plane]:
    """Return one over the diagonal of K + D' W D on the grid itself and on up to `most` coarser ones.

    Parameters
    ----------
    stiffness : (H, W) float32 array
        K.
    weights : three (H, W) float32 arrays
        W of the second differences xx, yy and xy.
    diagonal : (H, W) float32 array
        On the grid itself.
    most : int
        0 is a preconditioner by the diagonal alone.
    """
    inverse = [_one_over(diagonal)]
    means: tuple[Plane, ...] = (stiffness, *weights)
    spline = np.ones(1)
    for _ in range(most):
        if min(means[0].shape) < _LEAST_SIDE:
            break
        means = tuple(gathered(mean) / np.float32(4) for mean in means)
        between = np.zeros(2 * len(spline) - 1)
        between[::2] = spline
        spline = np.convolve(between, _SPLINE)
        value, slope, bend = (_power(spline, order) for order in range(3))
        k, xx, yy, xy = means
        here = value * value * k + value * bend * (xx + yy) + 2 * slope * slope * xy
        inverse.append(np.float32(_SHARE_OF_COARSER) * _one_over(np.asarray(here, np.float32)))
    return inverse


def answer(residual: Plane, inverse: list[Plane], level: int = 0) -> Plane:
    """Return the change (H, W) by which all grids answer a residual."""
    change: Plane = residual * inverse[level]
    if level + 1 < len(inverse):
        spread_onto(answer(gathered(residual), inverse, level + 1), change)
    return change


def gathered(fine: Plane) -> Plane:
    """Return what values (H, W) weigh in the functions of the next coarser grid: the transpose of `spread_onto`.

    Examples
    --------
    What the nodes get is what the pixels had:

    >>> float(gathered(np.ones((20, 30), np.float32)).sum())
    600.0
    """
    coarse = np.zeros(tuple((size + 1) // 2 + 2 for size in fine.shape), np.float32)
    _gather(fine, coarse)
    return coarse


def _power(spline: FloatArray, order: int) -> float:
    """Return the sum of the squares of a function's differences of some order."""
    differences = np.convolve(spline, ([1], [1, -1], [1, -2, 1])[order])
    return float(differences @ differences)


def _one_over(diagonal: Plane) -> Plane:
    """Return 0 where there is neither data nor smoothness."""
    held = diagonal > _LEAST_DIAGONAL
    return np.where(held, 1 / np.where(held, diagonal, 1), 0).astype(np.float32)


@njit(cache=True, nogil=True, fastmath=True)
def spread_onto(coarse: Plane, fine: Plane) -> None:
    """Add to values (H, W) what values at the nodes of the next coarser grid are there."""
    rows, cols = fine.shape
    eighth, half, six = np.float32(0.125), np.float32(0.5), np.float32(6)
    line = np.empty(coarse.shape[1], np.float32)
    for r in range(rows):
        first, second, third = coarse[r // 2], coarse[r // 2 + 1], coarse[r // 2 + 2]
        if r % 2 == 0:
            for c in range(len(line)):
                line[c] = eighth * (first[c] + six * second[c] + third[c])
        else:
            for c in range(len(line)):
                line[c] = half * (second[c] + third[c])
        own = fine[r]
        for c in range((cols + 1) // 2):
            own[2 * c] += eighth * (line[c] + six * line[c + 1] + line[c + 2])
        for c in range(cols // 2):
            own[2 * c + 1] += half * (line[c + 1] + line[c + 2])


@njit(cache=True, nogil=True, fastmath=True)
def _gather(fine: Plane, coarse: Plane) -> None:
    rows, cols = fine.shape
    nodes = coarse.shape[1]
    eighth, half, most = np.float32(0.125), np.float32(0.5), np.float32(0.75)
    line = np.empty(nodes, np.float32)
    # Pixels on nodes and between them, with none before the first and beyond the last.
    on, between = np.zeros(nodes + 2, np.float32), np.zeros(nodes + 2, np.float32)
    for r in range(rows):
        own = fine[r]
        for c in range((cols + 1) // 2):
            on[c + 2] = own[2 * c]
        for c in range(cols // 2):
            between[c + 2] = own[2 * c + 1]
        for c in range(nodes):
            line[c] = eighth * (on[c] + on[c + 2]) + most * on[c + 1] + half * (between[c] + between[c + 1])
        first, second, third = coarse[r // 2], coarse[r // 2 + 1], coarse[r // 2 + 2]
        if r % 2 == 0:
            for c in range(nodes):
                first[c] += eighth * line[c]
                second[c] += most * line[c]
                third[c] += eighth * line[c]
        else:
            for c in range(nodes):
                second[c] += half * line[c]
                third[c] += half * line[c]
