"""Exact nearest-neighbour search against its rivals, as one JSON table on stdout.

All in one run on the same SIFT descriptors of simulated views (two views at -4 and 4 deg of as many series as it
takes). `cpu_seconds` is the processor time of one thread, which a busy machine hardly changes; `seconds` is wall time
with all cores. `times_product` is how often the bare float32 matrix product fits into the time, and there are two of
them: `product`, over row blocks as wide as the whole set, and `product_in_cache`, over blocks of 256 x 1024 that never
leave the cache. Ours finds the two nearest of each row and the nearest of each column; the rivals only the former.
A rival that would take minutes is measured over the first rows alone (`rows`), its time scaled.

`memory` is a process that does nothing but match; `pruning` asks what a bound on the distance could save at best.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from isolated import Case, peak_memory_mb, run_cases

if TYPE_CHECKING:
    import numpy as np

    Descriptors = np.ndarray[Any, np.dtype[np.float32]]

_SIZES = (2_000, 8_000, 32_000, 100_000)
_SPECIMENS = ("fracture", "spheres", "pollen")
_REPEATS = {2_000: 7, 8_000: 5, 32_000: 3, 100_000: 1}
# Pairs that a rival slower than a product may compare before its time is scaled.
_MOST_PAIRS_OF_A_RIVAL = 2.6e8


def descriptors(n: int) -> tuple[Descriptors, Descriptors]:
    """Return `n` SIFT descriptors of each of two views."""
    import numpy as np

    from semscape.features.detect import detect
    from semscape.options import FeaturesOptions
    from semscape.simulate import SimulationOptions, simulate

    settings = SimulationOptions(tilts_deg=(-4.0, 4.0), samples=1)
    found: tuple[list[Descriptors], list[Descriptors]] = ([], [])
    series = 0
    while min(sum(map(len, views)) for views in found) < n:
        simulated, _ = simulate(_SPECIMENS[series % len(_SPECIMENS)], settings, rng=series)
        for views, view in zip(found, simulated.views, strict=True):
            views.append(detect(view, FeaturesOptions()).descriptors)
        series += 1
    one, two = (np.concatenate(views)[:n] for views in found)
    return one, two


def measure_speed() -> dict[str, Any]:
    """Time every method at every size."""
    import os

    import numpy as np

    from semscape.features.nearest import fastest_arithmetic

    all_one, all_two = descriptors(max(_SIZES))
    # The same descriptors with half the levels fit bytes.
    halved = tuple(np.minimum(np.rint(item / 2), 255) for item in (all_one, all_two))
    rng = np.random.default_rng(0)
    bits = tuple(rng.integers(0, 256, (max(_SIZES), 32)).astype(np.uint8) for _ in range(2))
    table: dict[str, Any] = {
        "cores": os.cpu_count(),
        "detected_arithmetic": fastest_arithmetic(all_one, all_two),
    }
    for n in _SIZES:
        one, two = all_one[:n], all_two[:n]
        methods = _methods(one, two, halved[0][:n], halved[1][:n], bits[0][:n], bits[1][:n])
        best: dict[str, dict[str, float]] = {name: {"cpu_seconds": np.inf, "seconds": np.inf} for name in methods}
        for name, (_, rows) in methods.items():
            if rows < n:
                best[name]["rows"] = rows
        for repeat in range(_REPEATS[n]):
            for name, (call, rows) in methods.items():  # in turn, so that a busy minute hits all alike
                if repeat and rows < n:
                    continue
                for key, threads, clock in (
                    ("cpu_seconds", 1, time.process_time),
                    ("seconds", os.cpu_count() or 1, time.perf_counter),
                ):
                    best[name][key] = min(best[name][key], _timed(call, threads, clock) * n / rows)
        unit = best["product"]
        for row in best.values():
            row["times_product"] = round(unit["cpu_seconds"] / row["cpu_seconds"], 3)
            row["times_product_all_cores"] = round(unit["seconds"] / row["seconds"], 3)
            row["gigapairs_per_cpu_second"] = round(n * n / row["cpu_seconds"] / 1e9, 3)
            row["cpu_seconds"], row["seconds"] = round(row["cpu_seconds"], 4), round(row["seconds"], 4)
        table[str(n)] = best
    return table


def _methods(
    one: Descriptors, two: Descriptors, half1: Descriptors, half2: Descriptors, bits1: Any, bits2: Any
) -> dict[str, tuple[Callable[[int], Any], int]]:
    """Return for each method a call that takes the number of threads, and how many rows it compares."""
    import cv2
    import faiss
    import numpy as np

    from semscape.features.nearest import two_nearest
    from semscape.features.tile import HAS_INTEGER_PRODUCTS

    n = len(one)
    rows = min(n, max(500, int(_MOST_PAIRS_OF_A_RIVAL / n)))
    transposed = np.ascontiguousarray(two.T)
    blocks = [np.ascontiguousarray(transposed[:, start : start + 1024]) for start in range(0, n, 1024)]
    wide, narrow = np.empty((512, n), np.float32), np.empty((256, 1024), np.float32)

    def product(_: int) -> None:
        for start in range(0, n, 512):
            block = one[start : start + 512]
            np.matmul(block, transposed, out=wide[: len(block)])

    def product_in_cache(_: int) -> None:
        for start in range(0, n, 256):
            block = one[start : start + 256]
            for columns in blocks:
                if columns.shape[1] == 1024 and len(block) == 256:
                    np.matmul(block, columns, out=narrow)
                else:
                    block @ columns

    def opencv(first: Any, second: Any, norm: int) -> Callable[[int], Any]:
        return lambda _: cv2.BFMatcher(norm).knnMatch(first[:rows], second, k=2)

    def faiss_flat(_: int) -> Any:
        index = faiss.IndexFlatL2(one.shape[1])
        index.add(two)
        return index.search(one[:rows], 2)

    def ours(first: Any, second: Any, arithmetic: str) -> Callable[[int], Any]:
        two_nearest(first[:9], second[:9], arithmetic=arithmetic)  # compiles
        return lambda threads: two_nearest(first, second, workers=threads, arithmetic=arithmetic)

    methods: dict[str, tuple[Callable[[int], Any], int]] = {
        "product": (product, n),
        "product_in_cache": (product_in_cache, n),
        "ours_floats": (ours(one, two, "floats"), n),
    }
    if HAS_INTEGER_PRODUCTS:
        methods["ours_words"] = (ours(one, two, "words"), n)
        methods["ours_bytes"] = (ours(half1, half2, "bytes"), n)
    return methods | {
        "faiss_flat": (faiss_flat, rows),
        "opencv_brute_force": (opencv(one, two, cv2.NORM_L2), rows),
        "ours_bits_of_256": (ours(bits1, bits2, "bits"), n),
        "opencv_bits_of_256": (opencv(bits1, bits2, cv2.NORM_HAMMING), rows),
    }


def _timed(call: Callable[[int], Any], threads: int, clock: Callable[[], float]) -> float:
    import cv2
    import faiss
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(threads)
    faiss.omp_set_num_threads(threads)
    with threadpool_limits(threads):
        start = clock()
        call(threads)
        return clock() - start


def measure_memory() -> dict[str, Any]:
    """Match two sets of the largest size and tell the peak memory of the whole process."""
    import numpy as np

    from semscape.features.nearest import fastest_arithmetic, two_nearest

    n = max(_SIZES)
    rng = np.random.default_rng(0)
    one, two = (rng.integers(0, 300, (n, 128), dtype=np.int16).astype(np.float32) for _ in range(2))
    before = peak_memory_mb()
    two_nearest(one, two, workers=2)
    return {
        "keypoints": n,
        "arithmetic": fastest_arithmetic(one, two),
        "descriptors_mb": round((one.nbytes + two.nbytes) / 1e6, 1),
        "peak_before_mb": round(before, 1),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


def measure_pruning() -> dict[str, Any]:
    """Tell which share of pairs a bound leaves over if the final limits were known from the start.

    The bound: after the first k principal coordinates, the rest differs by at least the difference of the rests'
    lengths (Cauchy-Schwarz). A pair is out when the bound exceeds both the row's second smallest and the column's
    smallest distance; a tile only when all its pairs are out.
    """
    import numpy as np

    from semscape.features.nearest import two_nearest
    from semscape.features.tile import LANES, TILE_COLUMNS, TILE_ROWS

    n = TILE_ROWS * TILE_COLUMNS * 20
    one, two = descriptors(n)
    _, _, second, _ = two_nearest(one, two)
    _, column, _, _ = two_nearest(two, one)
    _, axes = np.linalg.eigh(np.cov(np.concatenate([one, two]).T))
    turned1, turned2 = ((item.astype(np.float64) @ axes[:, ::-1]) for item in (one, two))
    table: dict[str, Any] = {"keypoints": n}
    for k in (8, 16, 32, 48, 64, 96):
        rest1, rest2 = (np.linalg.norm(item[:, k:], axis=1) for item in (turned1, turned2))
        left = np.zeros((n // TILE_ROWS, n), bool)
        pairs = 0
        for start in range(0, n, TILE_ROWS * 64):
            rows = slice(start, start + TILE_ROWS * 64)
            a, b = turned1[rows, :k], turned2[:, :k]
            bound = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T + (rest1[rows, None] - rest2) ** 2
            over = bound <= np.maximum(second[rows, None], column)
            pairs += int(over.sum())
            left[start // TILE_ROWS : start // TILE_ROWS + len(over) // TILE_ROWS] = over.reshape(-1, TILE_ROWS, n).any(
                axis=1
            )
        table[str(k)] = {
            "pairs_left": round(pairs / n**2, 5),
            "vectors_left": round(float(left.reshape(len(left), -1, LANES).any(axis=2).mean()), 4),
            "tiles_left": round(float(left.reshape(len(left), -1, TILE_COLUMNS).any(axis=2).mean()), 4),
        }
    return table


CASES: dict[str, Case] = {
    "speed": (measure_speed, ()),
    "memory": (measure_memory, ()),
    "pruning": (measure_pruning, ()),
}

if __name__ == "__main__":
    run_cases(CASES, "Speed and memory of the exact nearest-neighbour search and its rivals, as JSON.")
