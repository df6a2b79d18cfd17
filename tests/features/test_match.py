"""Matching: exact, mutual, and the same on every machine."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.features.match import match
from semscape.types import Keypoints


def descriptors(n: int, seed: int, levels: int = 200, dimension: int = 32) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, levels, (n, dimension)).astype(np.float32)


def keypoints(described: np.ndarray) -> Keypoints:
    one = np.ones(len(described))
    return Keypoints(np.column_stack([np.arange(len(described)), one]), one, one, one, described, "sift")


def test_matches_are_mutual_and_pass_the_ratio() -> None:
    one = descriptors(300, 0)
    two = np.concatenate([one[100:200] + np.random.default_rng(1).integers(-3, 4, (100, 32)), descriptors(150, 2)])
    found = match((0, 1), keypoints(one), keypoints(two.astype(np.float32)), ratio=0.8)
    np.testing.assert_array_equal(found.indices, np.column_stack([np.arange(100, 200), np.arange(100)]))
    assert len(set(found.indices[:, 1])) == len(found)
    assert found.pair == (0, 1)
    length = np.linalg.norm(one[0])
    expected = np.linalg.norm(one[100] - two[0]) / length
    assert found.distance[0] == pytest.approx(expected, rel=1e-6)


def test_binary_descriptors_match_by_their_bits() -> None:
    rng = np.random.default_rng(0)
    one = rng.integers(0, 256, (200, 32)).astype(np.uint8)
    two = one[50:150] ^ (rng.random((100, 32)) < 0.05).astype(np.uint8)
    found = match((0, 1), keypoints(one), keypoints(two), ratio=0.8)
    np.testing.assert_array_equal(found.indices, np.column_stack([np.arange(50, 150), np.arange(100)]))
    np.testing.assert_array_equal(found.distance, np.bitwise_count(one[50:150] ^ two).sum(axis=1) / 256)


def test_the_ratio_of_bits_is_that_of_distances() -> None:
    one = np.array([[0], [0b11111111]], np.uint8)
    two = np.array([[0b1], [0b11]], np.uint8)  # at 1 and 2 bits from the first
    assert match((0, 1), keypoints(one), keypoints(two), ratio=0.6).indices.tolist() == [[0, 0]]
    assert len(match((0, 1), keypoints(one), keypoints(two), ratio=0.4)) == 0


def test_ambiguous_matches_fail_the_ratio() -> None:
    one = descriptors(50, 0)
    two = np.concatenate([one, one])  # everything twice: nothing is distinct
    assert len(match((0, 1), keypoints(one), keypoints(two), ratio=1.0)) == 0


def test_too_few_keypoints_match_nothing() -> None:
    found = match((2, 5), keypoints(descriptors(1, 0)), keypoints(descriptors(9, 1)), ratio=0.8)
    assert (len(found), found.pair) == (0, (2, 5))


@pytest.mark.parametrize("ratio", [0.0, -1.0, 1.01, float("nan")])
def test_a_ratio_out_of_range_is_misuse(ratio: float) -> None:
    with pytest.raises(ValueError, match="ratio is"):
        match((0, 1), keypoints(descriptors(9, 0)), keypoints(descriptors(9, 1)), ratio=ratio)


def test_the_way_back_is_the_way_forward() -> None:
    one, two = descriptors(400, 3), descriptors(350, 4)
    there = match((0, 1), keypoints(one), keypoints(two), ratio=1.0)
    back = match((0, 1), keypoints(two), keypoints(one), ratio=1.0)
    forward = {tuple(pair) for pair in there.indices.tolist()}
    backward = {(b, a) for a, b in back.indices.tolist()}
    assert forward == backward  # without a ratio test, mutual nearest neighbours know no direction
