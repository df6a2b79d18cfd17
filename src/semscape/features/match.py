"""Exact nearest-neighbour matching of two views' descriptors.

Descriptors are whole numbers in float32, so squared distances n1 + n2 - 2 d1.d2 come exactly out of a
blocked matrix product. One pass over each block keeps the two nearest neighbours of every row and the
nearest of every column; the whole distance matrix never exists.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semscape.types import FloatArray, IntArray, Keypoints, Matches

_BLOCK_ROWS = 512


def match(pair: tuple[int, int], keypoints1: Keypoints, keypoints2: Keypoints, *, ratio: float) -> Matches:
    """Match the keypoints of two views by mutual nearest neighbours that pass the ratio test.

    Parameters
    ----------
    pair : (int, int)
        View indices i1 < i2.
    keypoints1, keypoints2 : Keypoints
        With float descriptors of one kind.
    ratio : float
        Largest ratio of the nearest to the second nearest distance, in (0, 1].

    Returns
    -------
    Matches
        `indices` (M, 2) sorted by the first column, `distance` (M,) in units of a descriptor's length.

    References
    ----------
    Lowe 2004, doi:10.1023/B:VISI.0000029664.99615.94
    """
    if not 0 < ratio <= 1:
        raise ValueError(f"ratio is {ratio}, must lie in (0, 1]")
    if len(keypoints1) < 2 or len(keypoints2) < 2:
        return Matches(pair, np.empty((0, 2), np.int64), np.empty(0))
    nearest, squared, second_squared, back = two_nearest(keypoints1.descriptors, keypoints2.descriptors)
    rows = np.arange(len(nearest))
    good = (back[nearest] == rows) & (squared < ratio * ratio * second_squared)
    indices = np.column_stack([rows[good], nearest[good]]).astype(np.int64)
    length = float(np.linalg.norm(keypoints1.descriptors[0]))
    return Matches(pair, indices, np.sqrt(squared[good]) / length)


def two_nearest(
    descriptors1: NDArray[np.float32], descriptors2: NDArray[np.float32]
) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
    """Find for each row of `descriptors1` (N1, D) its two nearest in `descriptors2` (N2, D), and the way back.

    Returns
    -------
    nearest : (N1,) int
        Index of the nearest; the lower index wins a tie.
    squared, second_squared : (N1,) float
        Squared distances to the nearest and the second nearest.
    back : (N2,) int
        Index of the nearest in `descriptors1` for each row of `descriptors2`.
    """
    n1, n2 = len(descriptors1), len(descriptors2)
    norm1 = np.einsum("nd,nd->n", descriptors1, descriptors1, dtype=np.float32)
    norm2 = np.einsum("nd,nd->n", descriptors2, descriptors2, dtype=np.float32)
    nearest = np.zeros(n1, np.int64)
    squared = np.full(n1, np.inf, np.float32)
    second_squared = np.full(n1, np.inf, np.float32)
    back = np.zeros(n2, np.int64)
    back_squared = np.full(n2, np.inf, np.float32)
    transposed = np.ascontiguousarray(descriptors2.T)
    for start in range(0, n1, _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, n1)
        products = descriptors1[start:stop] @ transposed
        _update_nearest(products, start, norm1, norm2, nearest, squared, second_squared, back, back_squared)
    return nearest, squared.astype(np.float64), second_squared.astype(np.float64), back


@njit(cache=True, nogil=True)
def _update_nearest(
    products: NDArray[np.float32],
    start: int,
    norm1: NDArray[np.float32],
    norm2: NDArray[np.float32],
    nearest: IntArray,
    squared: NDArray[np.float32],
    second_squared: NDArray[np.float32],
    back: IntArray,
    back_squared: NDArray[np.float32],
) -> None:
    rows, columns = products.shape
    two = np.float32(2)
    for row in range(rows):
        i = start + row
        own = norm1[i]
        best, second, best_column = np.float32(np.inf), np.float32(np.inf), 0
        for column in range(columns):
            distance = own + norm2[column] - two * products[row, column]
            if distance < second:
                if distance < best:
                    second, best, best_column = best, distance, column
                else:
                    second = distance
            if distance < back_squared[column]:
                back_squared[column] = distance
                back[column] = i
        nearest[i], squared[i], second_squared[i] = best_column, best, second
