"""Matching: exact, mutual, and the same on every machine."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.features.match import match, two_nearest
from semscape.types import Keypoints


def descriptors(n: int, seed: int, levels: int = 200, dimension: int = 32) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, levels, (n, dimension)).astype(np.float32)


def keypoints(described: np.ndarray) -> Keypoints:
    one = np.ones(len(described))
    return Keypoints(np.column_stack([np.arange(len(described)), one]), one, one, one, described, "sift")


@pytest.mark.parametrize(("n1", "n2"), [(2, 2), (37, 11), (513, 700), (1500, 60)])
@pytest.mark.parametrize("levels", [2, 200])  # two levels make ties the rule
def test_two_nearest_equals_brute_force(n1: int, n2: int, levels: int) -> None:
    one, two = descriptors(n1, 0, levels, 8), descriptors(n2, 1, levels, 8)
    nearest, squared, second, back = two_nearest(one, two)
    distance = ((one[:, None].astype(np.float64) - two[None]) ** 2).sum(axis=2)
    # argmin and a stable sort take the lower index of equal distances
    np.testing.assert_array_equal(nearest, distance.argmin(axis=1))
    np.testing.assert_array_equal(back, distance.argmin(axis=0))
    ordered = np.sort(distance, axis=1)
    np.testing.assert_array_equal(squared, ordered[:, 0])
    np.testing.assert_array_equal(second, ordered[:, 1])


def test_the_lower_index_wins_a_tie() -> None:
    one = np.array([[1, 0, 0]], np.float32)
    two = np.array([[0, 5, 0], [0, 1, 0], [0, 0, 1], [2, 0, 9]], np.float32)
    nearest, squared, second, back = two_nearest(one, two)
    assert (nearest[0], squared[0], second[0]) == (1, 2, 2)
    assert back.tolist() == [0, 0, 0, 0]


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
