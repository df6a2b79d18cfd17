"""Nearest neighbours: equal to brute force in every arithmetic, ties included, for any number of threads."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semscape.features.nearest import ARITHMETICS, fastest_arithmetic, two_nearest
from semscape.features.tile import HAS_INTEGER_PRODUCTS, TILE_COLUMNS, TILE_ROWS

FLOAT_ARITHMETICS = [name for name in ARITHMETICS if name == "floats" or (name != "bits" and HAS_INTEGER_PRODUCTS)]


def whole_numbers(n: int, seed: int, high: int, dimension: int, low: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(low, high, (n, dimension)).astype(np.float32)


def brute_force(distance: np.ndarray) -> tuple[np.ndarray, ...]:
    # argmin takes the lower index of equal distances
    ordered = np.sort(np.column_stack([distance, np.full(len(distance), np.inf)]), axis=1)
    return distance.argmin(axis=1), ordered[:, 0], ordered[:, 1], distance.argmin(axis=0)


def assert_brute_force(one: np.ndarray, two: np.ndarray, **how: object) -> None:
    if one.dtype == np.uint8:
        distance = np.bitwise_count(one[:, None] ^ two[None]).sum(axis=2, dtype=np.float64)
    else:
        distance = ((one[:, None].astype(np.float64) - two[None]) ** 2).sum(axis=2)
    for got, wanted in zip(two_nearest(one, two, **how), brute_force(distance), strict=True):  # type: ignore[arg-type]
        np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("arithmetic", FLOAT_ARITHMETICS)
@settings(max_examples=40, deadline=None)
@given(
    n1=st.integers(1, 3 * TILE_ROWS + 1),
    n2=st.integers(1, 2 * TILE_COLUMNS + 1),
    dimension=st.integers(1, 9),
    high=st.sampled_from([1, 2, 3, 256]),  # one level makes all equal, two or three make ties the rule
    seed=st.integers(0, 99),
    workers=st.integers(1, 3),
)
def test_floats_equal_brute_force(
    arithmetic: str, n1: int, n2: int, dimension: int, high: int, seed: int, workers: int
) -> None:
    one, two = whole_numbers(n1, seed, high, dimension), whole_numbers(n2, seed + 100, high, dimension)
    assert_brute_force(one, two, arithmetic=arithmetic, workers=workers)


@settings(max_examples=40, deadline=None)
@given(
    n1=st.integers(1, 3 * TILE_ROWS + 1),
    n2=st.integers(1, 2 * TILE_COLUMNS + 1),
    n_bytes=st.integers(1, 33),
    high=st.sampled_from([1, 2, 256]),
    seed=st.integers(0, 99),
)
def test_bits_equal_brute_force(n1: int, n2: int, n_bytes: int, high: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, two = (rng.integers(0, high, (n, n_bytes)).astype(np.uint8) for n in (n1, n2))
    assert_brute_force(one, two)


@pytest.mark.parametrize("arithmetic", FLOAT_ARITHMETICS)
def test_several_blocks_of_rows(arithmetic: str) -> None:
    one, two = whole_numbers(1700, 0, 200, 16), whole_numbers(900, 1, 200, 16)
    two[300:600] = one[800:1100]  # among strangers, neighbours at distance 0
    two[700:800] = two[300:400]
    assert_brute_force(one, two, arithmetic=arithmetic)


@pytest.mark.parametrize("arithmetic", FLOAT_ARITHMETICS)
@pytest.mark.parametrize("extreme", [(0, 0), (0, 255), (255, 0), (255, 255)])
def test_the_largest_bytes_do_not_overflow(arithmetic: str, extreme: tuple[int, int]) -> None:
    one, two = (np.full((9, 128), value, np.float32) for value in extreme)
    two[4, 7] += 1 if extreme[1] == 0 else -1
    assert_brute_force(one, two, arithmetic=arithmetic)


def test_signed_descriptors_and_the_largest_words() -> None:
    one, two = whole_numbers(50, 0, 1000, 128, low=-1000), whole_numbers(40, 1, 1000, 128, low=-1000)
    one[3], two[5] = -1000, 1000
    assert_brute_force(one, two)
    for level in (1023, 4000, 5000):  # sums of squares grow towards what float32 holds exactly
        assert_brute_force(np.sign(one[:, :1]) * level, np.sign(two[:, :1]) * level)


def test_the_fastest_exact_arithmetic_is_taken() -> None:
    byte, word = whole_numbers(5, 0, 255, 128), whole_numbers(5, 0, 1023, 128)
    integers = (lambda name: name) if HAS_INTEGER_PRODUCTS else (lambda name: "floats")
    assert fastest_arithmetic(byte, byte) == integers("bytes")
    assert fastest_arithmetic(byte, word) == integers("words")
    assert fastest_arithmetic(-byte, byte) == integers("words")
    assert fastest_arithmetic(byte, byte + np.float32(0.5)) == "floats"
    assert fastest_arithmetic(byte, byte * 100) == "floats"
    assert fastest_arithmetic(byte.astype(np.uint8), byte.astype(np.uint8)) == "bits"


def test_fractions_are_compared_to_rounding() -> None:
    rng = np.random.default_rng(0)
    one, two = (rng.normal(size=(n, 64)).astype(np.float32) for n in (150, 170))
    distance = ((one[:, None].astype(np.float64) - two[None]) ** 2).sum(axis=2)
    nearest, squared, second, back = two_nearest(one, two)
    wanted = brute_force(distance)
    np.testing.assert_array_equal(nearest, wanted[0])
    np.testing.assert_allclose(squared, wanted[1], rtol=1e-5)
    np.testing.assert_allclose(second, wanted[2], rtol=1e-5)
    np.testing.assert_array_equal(back, wanted[3])


def test_threads_change_nothing() -> None:
    one, two = whole_numbers(200, 0, 2, 8), whole_numbers(500, 1, 2, 8)
    alone = two_nearest(one, two)
    for workers in (2, 3, 7, 1000):
        for got, wanted in zip(two_nearest(one, two, workers=workers), alone, strict=True):
            assert got.tobytes() == wanted.tobytes()


def test_sets_that_do_not_belong_together_are_misuse() -> None:
    one = whole_numbers(5, 0, 9, 8)
    with pytest.raises(ValueError, match="differ in kind"):
        two_nearest(one, one.astype(np.uint8))
    with pytest.raises(ValueError, match="differ in kind"):
        two_nearest(one, one[:, :4])
    with pytest.raises(ValueError, match="no neighbours among 5 and 0"):
        two_nearest(one, one[:0])


_OLDER_MACHINE = """
import numpy as np
from semscape.features.nearest import two_nearest
from semscape.features.tile import HAS_INTEGER_PRODUCTS, LANES
rng = np.random.default_rng(5)
one, two = (rng.integers(0, 3, (n, 8)).astype(np.float32) for n in (40, 70))
print(LANES, HAS_INTEGER_PRODUCTS, *[hash(item.tobytes()) for item in two_nearest(one, two)])
"""


@pytest.mark.skipif(platform.machine() not in {"x86_64", "AMD64"}, reason="names an x86 processor")
def test_an_older_machine_gives_the_same_bytes() -> None:
    older = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+avx,+fma,+sse4.2,+popcnt,+bmi,+bmi2,+lzcnt"}
    environment = os.environ | {"PYTHONHASHSEED": "0"}
    texts = [
        subprocess.run(
            [sys.executable, "-c", _OLDER_MACHINE], env=environment | given, capture_output=True, text=True, check=True
        ).stdout.split()
        for given in ({}, older)
    ]
    assert texts[1][:2] == ["8", "False"]
    assert texts[0][2:] == texts[1][2:]
