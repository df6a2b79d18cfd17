"""Exact nearest neighbours of two sets of descriptors, both directions in one pass.

The distance matrix never exists: register tiles of it (`semscape.features.tile`) are compared with what their
rows and columns have found so far and forgotten. Whole-number descriptors give whole-number distances, so the
answer is the same on every machine, for every arithmetic and any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.features.tile import HAS_INTEGER_PRODUCTS, TILE_COLUMNS, TILE_ROWS, compare_tile, lowest_bit
from semscape.types import FloatArray, IntArray

_PANELS_PER_BLOCK = 128  # rows of a block stay in the second-level cache while the columns pass by
_LARGEST_BYTE = 255
# Farther than any distance, as far as half of it and a half norm more still fit 32 bits.
_FAR = 2**30


@dataclass(frozen=True)
class _Packed:
    """Both sets as the tile wants them, and the shares of rows and columns in a squared distance.

    A squared distance is 2 (tile + row_share) + row_odd + column_odd, where the tile starts from `start`.
    """

    panels: NDArray[Any]
    tiles: NDArray[Any]
    start: NDArray[Any]
    row_share: NDArray[Any]
    row_odd: NDArray[Any]
    column_odd: NDArray[Any]


def two_nearest(
    descriptors1: NDArray[Any], descriptors2: NDArray[Any], *, workers: int = 1, arithmetic: str | None = None
) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
    """Find for each row of `descriptors1` (N1, D) its two nearest in `descriptors2` (N2, D), and the way back.

    Parameters
    ----------
    descriptors1, descriptors2 : arrays
        Both float32, compared by squared Euclidean distance, or both uint8, bit strings compared by Hamming
        distance. Floats that are whole numbers are compared exactly.
    workers : int
        Threads; no result depends on it.
    arithmetic : str, optional
        One of `ARITHMETICS`; by default the fastest that is exact for these descriptors on this machine.

    Returns
    -------
    nearest : (N1,) int
        Index of the nearest; the lower index wins a tie.
    distance, second_distance : (N1,) float
        Squared Euclidean or Hamming distances to the nearest and the second nearest, infinite where there is none.
    back : (N2,) int
        Index of the nearest in `descriptors1` for each row of `descriptors2`.

    Raises
    ------
    ValueError
        For descriptors of two kinds or lengths, or an empty set.

    Examples
    --------
    >>> one, two = np.eye(3, dtype=np.float32), np.array([[0, 2, 0], [1, 0, 1]], dtype=np.float32)
    >>> nearest, squared, second, back = two_nearest(one, two)
    >>> nearest.tolist(), squared.tolist(), second.tolist(), back.tolist()
    ([1, 0, 1], [1.0, 1.0, 1.0], [5.0, 3.0, 5.0], [1, 0])
    """
    if descriptors1.dtype != descriptors2.dtype or descriptors1.shape[1:] != descriptors2.shape[1:]:
        raise ValueError(
            f"descriptors differ in kind: {descriptors1.dtype} x {descriptors1.shape[1:]} against "
            f"{descriptors2.dtype} x {descriptors2.shape[1:]}"
        )
    n1, n2 = len(descriptors1), len(descriptors2)
    if n1 == 0 or n2 == 0:
        raise ValueError(f"no neighbours among {n1} and {n2} descriptors")
    packed = ARITHMETICS[arithmetic or fastest_arithmetic(descriptors1, descriptors2)](descriptors1, descriptors2)
    panels = len(packed.panels)
    cuts = np.linspace(0, panels, min(workers, panels) + 1).astype(int)
    number = packed.start.dtype
    far = number.type(np.inf if number.kind == "f" else _FAR)
    nearest = np.zeros(panels * TILE_ROWS, np.int32)
    row_distance = np.full((panels * TILE_ROWS, 2), far, number)
    column_distance = np.full((len(cuts) - 1, len(packed.start)), far, number)
    back = np.zeros(column_distance.shape, np.int32)

    def search(part: int) -> None:
        _search(
            packed.panels, packed.tiles, packed.start, packed.row_share, packed.row_odd, packed.column_odd,
            int(cuts[part]), int(cuts[part + 1]),
            nearest, row_distance, back[part], column_distance[part],
        )  # fmt: skip

    if len(cuts) == 2:
        search(0)
    else:
        with ThreadPoolExecutor(len(cuts) - 1) as pool:
            list(pool.map(search, range(len(cuts) - 1)))
    # Of equal distances the first part's wins, and its rows have the lower indices.
    winner = column_distance[:, :n2].argmin(axis=0)
    distances = row_distance[:n1].astype(np.float64)
    distances[row_distance[:n1] == far] = np.inf
    if descriptors1.dtype == np.uint8:
        distances /= 2
    return (
        nearest[:n1].astype(np.int64),
        distances[:, 0],
        distances[:, 1],
        back[winner, np.arange(n2)].astype(np.int64),
    )


def fastest_arithmetic(descriptors1: NDArray[Any], descriptors2: NDArray[Any]) -> str:
    """Return the name of the fastest arithmetic that is exact for these descriptors on this machine."""
    if descriptors1.dtype == np.uint8:
        return "bits"
    if not HAS_INTEGER_PRODUCTS:
        return "floats"
    low, high, whole = _span(descriptors1)
    low2, high2, whole2 = _span(descriptors2)
    low, high = min(low, low2), max(high, high2)
    if not (whole and whole2):
        return "floats"
    if low >= 0 and high <= _LARGEST_BYTE:
        return "bytes"
    # Squared distances, at most D (2 max)^2, must stay clear of what stands for "none yet".
    return "words" if 4 * descriptors1.shape[1] * max(high, -low) ** 2 < _FAR // 2 else "floats"


@njit(cache=True, nogil=True)
def _span(descriptors: NDArray[np.float32]) -> tuple[np.float32, np.float32, bool]:  # pragma: no cover - compiled
    """Return the least and the largest value, and whether all are whole numbers."""
    low, high, whole = np.float32(0), np.float32(0), True
    for row in descriptors:
        for value in row:
            low, high = min(low, value), max(high, value)
            whole &= value == np.floor(value)
    return low, high, whole


def _pack_bytes(descriptors1: NDArray[np.float32], descriptors2: NDArray[np.float32]) -> _Packed:
    # The instruction multiplies unsigned by signed bytes: sum a (127 - b) = 127 sum a - a.b keeps both in range,
    # and the first term is the row's.
    one, two = descriptors1.astype(np.uint8), (127 - descriptors2.astype(np.int16)).astype(np.int8)
    sums = descriptors1.sum(axis=1, dtype=np.float64).astype(np.int64)
    return _packed_integers(one, two, _squared_norms(descriptors1), _squared_norms(descriptors2), -127 * sums)


def _pack_words(descriptors1: NDArray[np.float32], descriptors2: NDArray[np.float32]) -> _Packed:
    one, two = -descriptors1.astype(np.int16), descriptors2.astype(np.int16)
    zero = np.zeros(len(one), np.int64)
    return _packed_integers(one, two, _squared_norms(descriptors1), _squared_norms(descriptors2), zero)


def _pack_bits(descriptors1: NDArray[np.uint8], descriptors2: NDArray[np.uint8]) -> _Packed:
    zero1, zero2 = np.zeros(len(descriptors1), np.int64), np.zeros(len(descriptors2), np.int64)
    packed = _packed_integers(descriptors1, descriptors2, zero1, zero2, zero1)
    return replace(packed, panels=packed.panels.view(np.uint32))


def _packed_integers(
    one: NDArray[Any], two: NDArray[Any], squared1: IntArray, squared2: IntArray, share: IntArray
) -> _Packed:
    return _Packed(
        _in_panels(one, TILE_ROWS),
        _in_panels(two, TILE_COLUMNS),
        _padded((squared2 >> 1).astype(np.int32), TILE_COLUMNS, _FAR),
        _padded(((squared1 >> 1) + share).astype(np.int32), TILE_ROWS, _FAR // 2 + _FAR // 4),
        _padded((squared1 & 1).astype(np.int32), TILE_ROWS, 0),
        _padded((squared2 & 1).astype(np.int32), TILE_COLUMNS, 0),
    )


def _pack_floats(descriptors1: NDArray[np.float32], descriptors2: NDArray[np.float32]) -> _Packed:
    half1 = (0.5 * np.einsum("nd,nd->n", descriptors1, descriptors1, dtype=np.float64)).astype(np.float32)
    half2 = (0.5 * np.einsum("nd,nd->n", descriptors2, descriptors2, dtype=np.float64)).astype(np.float32)
    return _Packed(
        _in_panels(-descriptors1, TILE_ROWS),
        _in_panels(descriptors2, TILE_COLUMNS),
        _padded(half2, TILE_COLUMNS, np.inf),
        _padded(half1, TILE_ROWS, np.inf),
        _padded(np.zeros_like(half1), TILE_ROWS, 0),
        _padded(np.zeros_like(half2), TILE_COLUMNS, 0),
    )


ARITHMETICS: dict[str, Callable[[Any, Any], _Packed]] = {
    "bytes": _pack_bytes,
    "words": _pack_words,
    "floats": _pack_floats,
    "bits": _pack_bits,
}


def _squared_norms(descriptors: NDArray[np.float32]) -> IntArray:
    squared: IntArray = np.einsum("nd,nd->n", descriptors, descriptors, dtype=np.float64).astype(np.int64)
    return squared


def _padded(values: NDArray[Any], multiple: int, filler: float) -> NDArray[Any]:
    return np.pad(values, (0, -len(values) % multiple), constant_values=filler)


def _in_panels(values: NDArray[Any], width: int) -> NDArray[Any]:
    """Return (panels, groups, width, elements): lanes of 32 bits, those of one group of dimensions side by side."""
    elements = 4 // values.itemsize
    padded = np.pad(values, ((0, -len(values) % width), (0, -values.shape[1] % elements)))
    split = padded.reshape(-1, width, padded.shape[1] // elements, elements)
    return np.ascontiguousarray(split.transpose(0, 2, 1, 3))


def _upper_half(distance: Any) -> Any:
    """Return half a distance, rounded up; what is not below it cannot lead to a shorter one."""
    raise NotImplementedError("it exists in compiled code alone")


@overload(_upper_half)
def _compile_upper_half(distance: Any) -> Any:
    def of_whole_number(distance: Any) -> Any:  # pragma: no cover - compiled
        return (distance + 1) >> 1

    def of_float(distance: Any) -> Any:  # pragma: no cover - compiled
        return distance * np.float32(0.5)

    return of_whole_number if isinstance(distance, types.Integer) else of_float


@njit(cache=True, nogil=True)
def _search(
    panels: NDArray[Any],
    tiles: NDArray[Any],
    start: NDArray[Any],
    row_share: NDArray[Any],
    row_odd: NDArray[Any],
    column_odd: NDArray[Any],
    first_panel: int,
    last_panel: int,
    nearest: NDArray[np.int32],
    row_distance: NDArray[Any],
    back: NDArray[np.int32],
    column_distance: NDArray[Any],
) -> None:  # pragma: no cover - compiled
    """Search the panels from `first_panel` to before `last_panel`; the last four arrays are updated."""
    groups = panels.shape[1]
    panel_bytes, tile_bytes = panels[0].nbytes, tiles[0].nbytes
    row_limit = np.empty(len(row_share), row_share.dtype)
    column_limit = np.empty(len(start), start.dtype)
    for i in range(first_panel * TILE_ROWS, last_panel * TILE_ROWS):
        row_limit[i] = _upper_half(row_distance[i, 1] - row_odd[i]) - row_share[i]
    for j in range(len(start)):
        column_limit[j] = _upper_half(column_distance[j])
    out = np.empty((TILE_ROWS, TILE_COLUMNS), start.dtype)
    better = np.empty((TILE_ROWS, 2), np.uint64)
    for block in range(first_panel, last_panel, _PANELS_PER_BLOCK):
        for tile in range(len(tiles)):
            column0 = tile * TILE_COLUMNS
            for panel in range(block, min(block + _PANELS_PER_BLOCK, last_panel)):
                row0 = panel * TILE_ROWS
                if not compare_tile(
                    panels,
                    panels.ctypes.data + panel * panel_bytes,
                    tiles.ctypes.data + tile * tile_bytes,
                    start.ctypes.data + column0 * 4,
                    row_limit.ctypes.data + row0 * 4,
                    row_share.ctypes.data + row0 * 4,
                    column_limit.ctypes.data + column0 * 4,
                    out.ctypes.data,
                    better.ctypes.data,
                    groups,
                ):
                    continue
                for r in range(TILE_ROWS):
                    i = row0 + r
                    improving, improved = better[r, 0], better[r, 1]
                    while improving:
                        c = lowest_bit(improving)
                        improving &= improving - np.uint64(1)
                        j = column0 + c
                        distance = 2 * (out[r, c] + row_share[i]) + row_odd[i] + column_odd[j]
                        if distance < row_distance[i, 0]:
                            row_distance[i, 1] = row_distance[i, 0]
                            row_distance[i, 0] = distance
                            nearest[i] = j
                        elif distance < row_distance[i, 1]:
                            row_distance[i, 1] = distance
                    row_limit[i] = _upper_half(row_distance[i, 1] - row_odd[i]) - row_share[i]
                    while improved:
                        c = lowest_bit(improved)
                        improved &= improved - np.uint64(1)
                        j = column0 + c
                        distance = 2 * (out[r, c] + row_share[i]) + row_odd[i] + column_odd[j]
                        if distance < column_distance[j]:
                            column_distance[j] = distance
                            back[j] = i
                            column_limit[j] = _upper_half(distance)
