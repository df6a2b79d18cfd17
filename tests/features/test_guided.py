"""Guided matching: exact within the band, and it finds what repeats across the image but not along a line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semscape.features.guided import (
    add_guided_matches,
    epipolar_coordinates_px,
    is_parallel,
    two_nearest_in_band,
)
from semscape.features.match import match
from semscape.types import Keypoints, Matches, TwoViewGeometry

ROWS_AGREE = np.array([[0.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # y1 = y2


def keypoints(xy: np.ndarray, descriptors: np.ndarray) -> Keypoints:
    one = np.ones(len(xy))
    return Keypoints(xy, one, one, one, descriptors, "sift")


def geometry(matrix: np.ndarray, inliers: np.ndarray, threshold_px: float = 1.0) -> TwoViewGeometry:
    residual = np.where(inliers, 0.0, 50.0)
    return TwoViewGeometry((0, 1), "affine", matrix, inliers, residual, threshold_px, -100.0, 10)


@settings(max_examples=60, deadline=None)
@given(
    n1=st.integers(0, 30),
    n2=st.integers(0, 30),
    levels=st.sampled_from([1, 2, 9]),  # few levels make ties the rule
    band=st.sampled_from([0.0, 1.0, 3.0, 100.0]),
    seed=st.integers(0, 99),
)
def test_the_search_in_the_band_equals_brute_force(n1: int, n2: int, levels: int, band: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, two = (rng.integers(0, levels, (n, 5)).astype(np.float32) for n in (n1, n2))
    u1, u2 = (rng.integers(0, 12, n).astype(float) for n in (n1, n2))
    nearest, squared, second, back = two_nearest_in_band(one, u1, two, u2, band)
    distance = ((one[:, None].astype(float) - two[None]) ** 2).sum(axis=2)
    distance[np.abs(u1[:, None] - u2) > band] = np.inf
    padded = np.column_stack([distance, np.full((n1, 2), np.inf)])
    ordered = np.sort(padded, axis=1)
    np.testing.assert_array_equal(nearest, np.where(np.isinf(ordered[:, 0]), -1, padded.argmin(axis=1)))
    np.testing.assert_array_equal(squared, ordered[:, 0])
    np.testing.assert_array_equal(second, ordered[:, 1])
    below = np.vstack([distance, np.full((1, n2), np.inf)])
    np.testing.assert_array_equal(back, np.where(np.isinf(below.min(axis=0)), -1, below.argmin(axis=0)))


def test_coordinates_differ_by_the_residual() -> None:
    rng = np.random.default_rng(0)
    a, b, c, d, e = 0.3, -0.5, -0.28, 0.49, 3.0
    matrix = np.array([[0, 0, c], [0, 0, d], [a, b, e]])
    xy1, xy2 = rng.uniform(0, 100, (2, 20, 2))
    u1, u2 = epipolar_coordinates_px(geometry(matrix, np.ones(20, bool)), xy1, xy2)
    homogeneous1, homogeneous2 = (np.column_stack([xy, np.ones(20)]) for xy in (xy1, xy2))
    algebraic = np.abs(np.einsum("ni,ij,nj->n", homogeneous2, matrix, homogeneous1))
    to_lines = [np.hypot(*(homogeneous1 @ matrix.T)[:, :2].T), np.hypot(*(homogeneous2 @ matrix)[:, :2].T)]
    np.testing.assert_allclose(np.abs(u1 - u2), np.max([algebraic / length for length in to_lines], axis=0))


def repeated_texture(binary: bool) -> tuple[Keypoints, Keypoints, int]:
    """Return two views, shifted along x, of a texture whose last 30 keypoints look alike on three different lines."""
    rng = np.random.default_rng(4)
    n = 300
    xy = np.column_stack([rng.uniform(0, 300, n), np.arange(n)])
    described = rng.integers(0, 200, (n, 64))
    described[-20:-10], described[-10:] = described[-30:-20], described[-30:-20]
    if binary:
        described = described.astype(np.uint8)
        noisy = described.copy()
        noisy[:, :5] ^= 1  # as many bits in all, so that none is distinct by chance
    else:
        noisy = described + rng.integers(-2, 3, described.shape)
    as_stored = np.uint8 if binary else np.float32
    shift = np.column_stack([rng.uniform(4, 6, n), rng.normal(0, 0.1, n)])
    return keypoints(xy, described.astype(as_stored)), keypoints(xy + shift, noisy.astype(as_stored)), n


@pytest.mark.parametrize("binary", [False, True])
def test_what_repeats_elsewhere_is_found_on_its_line(binary: bool) -> None:
    one, two, n = repeated_texture(binary)
    found = match((0, 1), one, two, ratio=0.8)
    assert found.indices.tolist() == [[i, i] for i in range(n - 30)]
    matches, fitted = add_guided_matches(found, geometry(ROWS_AGREE, np.ones(len(found), bool)), one, two, ratio=0.8)
    assert matches.indices.tolist() == [[i, i] for i in range(n)]
    assert fitted.inliers.all()
    np.testing.assert_allclose(fitted.residual_px[-30:], np.abs(two.xy - one.xy)[-30:, 1])
    np.testing.assert_array_equal(matches.distance[: n - 30], found.distance)
    everything = match((0, 1), one, two, ratio=1.0)
    common = {tuple(pair): value for pair, value in zip(everything.indices.tolist(), everything.distance, strict=True)}
    for pair, value in zip(matches.indices.tolist(), matches.distance, strict=True):
        assert value == pytest.approx(common.get(tuple(pair), value), rel=1e-12)


def test_a_match_that_moves_unlike_its_neighbours_is_not_added() -> None:
    one, two, n = repeated_texture(binary=False)
    found = match((0, 1), one, two, ratio=0.8)
    moved = two.xy.copy()
    moved[-30:-15, 0] += 40.0
    inliers = np.ones(len(found), bool)
    matches, _ = add_guided_matches(
        found, geometry(ROWS_AGREE, inliers), one, keypoints(moved, two.descriptors), ratio=0.8
    )
    assert matches.indices[:, 0].tolist() == [*range(n - 30), *range(n - 15, n)]


def test_outliers_stay_outliers_and_may_find_their_true_partner() -> None:
    one, two, _ = repeated_texture(binary=False)
    found = match((0, 1), one, two, ratio=0.8)
    wrong = found.indices.copy()
    wrong[10] = 10, 200
    inliers = np.ones(len(found), bool)
    inliers[[10, 200]] = False
    matches, fitted = add_guided_matches(
        Matches((0, 1), wrong, found.distance), geometry(ROWS_AGREE, inliers), one, two, ratio=0.8
    )
    assert matches.indices[~fitted.inliers].tolist() == [[10, 200], [200, 200]]
    kept = matches.indices[fitted.inliers].tolist()
    assert [10, 10] in kept
    assert len({pair[0] for pair in kept}) == len({pair[1] for pair in kept}) == len(kept)


def test_lines_that_meet_are_misuse() -> None:
    matrix = np.array([[1e-6, 0, 0], [0, 0, 1], [0, -1, 0]])
    meeting = geometry(matrix, np.ones(3, bool))
    assert not is_parallel(meeting)
    with pytest.raises(ValueError, match="not parallel"):
        epipolar_coordinates_px(meeting, np.zeros((3, 2)), np.zeros((3, 2)))
