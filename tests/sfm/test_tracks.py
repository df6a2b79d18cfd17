"""Tracks: joined by union-find, never against themselves."""

from __future__ import annotations

import numpy as np

from semscape.sfm.tracks import build_tracks
from semscape.sfm.two_view import largest_connected_set, renumber
from semscape.types import Keypoints, Matches, TwoViewGeometry


def keypoints(n: int, view: int) -> Keypoints:
    one = np.ones(n)
    xy = np.column_stack([100.0 * view + np.arange(n), np.arange(n)])
    return Keypoints(xy, one, one, one, np.zeros((n, 4), np.float32), "sift")


def edges(pair: tuple[int, int], indices: list[tuple[int, int]], inliers: list[bool] | None = None):
    array = np.array(indices, dtype=np.int64).reshape(-1, 2)
    good = np.ones(len(array), bool) if inliers is None else np.array(inliers)
    residual = np.zeros(len(array))
    return Matches(pair, array, residual), TwoViewGeometry(pair, "affine", np.eye(3), good, residual, 1.0, -9.0, 1)


def build(n_views: int, *pairs):
    views = tuple(keypoints(10, view) for view in range(n_views))
    return build_tracks(views, tuple(m for m, _ in pairs), tuple(g for _, g in pairs))


def as_sets(observations) -> set[frozenset[tuple[int, int]]]:
    """Return each track as a set of (view, keypoint)."""
    keypoint = observations.xy[:, 1].astype(int)
    return {
        frozenset(
            (int(v), int(k))
            for v, k in zip(observations.view[observations.point == p], keypoint[observations.point == p], strict=True)
        )
        for p in range(observations.n_points)
    }


def test_pairs_chain_into_tracks() -> None:
    found = build(3, edges((0, 1), [(0, 5), (1, 6)]), edges((1, 2), [(5, 7)]), edges((0, 2), [(0, 7), (3, 3)]))
    assert as_sets(found) == {
        frozenset({(0, 0), (1, 5), (2, 7)}),
        frozenset({(0, 1), (1, 6)}),
        frozenset({(0, 3), (2, 3)}),
    }


def test_tracks_that_contradict_themselves_are_dropped() -> None:
    found = build(3, edges((0, 1), [(0, 5), (1, 6)]), edges((1, 2), [(5, 7), (6, 8)]), edges((0, 2), [(4, 7)]))
    assert as_sets(found) == {frozenset({(0, 1), (1, 6), (2, 8)})}  # view 0 would see the other one twice


def test_outliers_join_nothing() -> None:
    found = build(2, edges((0, 1), [(0, 5), (1, 6)], [True, False]))
    assert as_sets(found) == {frozenset({(0, 0), (1, 5)})}


def test_tracks_are_sorted_by_point_then_view() -> None:
    found = build(3, edges((0, 2), [(9, 1), (2, 2)]), edges((1, 2), [(0, 1), (4, 4)]), edges((0, 1), [(1, 8)]))
    assert (np.diff(found.point) >= 0).all()
    assert np.unique(found.point).tolist() == list(range(found.n_points))
    same = np.diff(found.point) == 0
    assert (np.diff(found.view)[same] > 0).all()
    assert (np.bincount(found.point) >= 2).all()


def test_a_place_with_two_orientations_makes_one_track() -> None:
    one = np.ones(2)
    twice = Keypoints(np.array([[5.0, 5.0], [5.0, 5.0]]), one, one, one, np.zeros((2, 4), np.float32), "sift")
    found = build_tracks((twice, twice), *([part] for part in edges((0, 1), [(0, 0), (1, 1)])))
    assert found.n_points == 1


def test_no_inliers_make_no_tracks() -> None:
    assert build(3).n_points == 0
    assert build(2, edges((0, 1), [(0, 1)], [False])).n_points == 0


def test_the_order_of_the_pairs_does_not_matter() -> None:
    pairs = [edges((0, 1), [(0, 5), (1, 6)]), edges((1, 2), [(5, 7)]), edges((0, 2), [(3, 3)])]
    one, two = build(3, *pairs), build(3, *reversed(pairs))
    np.testing.assert_array_equal(one.xy, two.xy)
    np.testing.assert_array_equal(one.point, two.point)


def test_views_hang_together_through_pairs() -> None:
    assert largest_connected_set([], 3) == (0,)
    assert largest_connected_set([(0, 1), (2, 3)], 4) == (0, 1)
    assert largest_connected_set([(0, 4), (2, 3), (3, 4)], 5) == (0, 2, 3, 4)


def test_renumbering_keeps_the_pairs_of_the_kept_views() -> None:
    pairs = [edges((0, 2), [(0, 1)]), edges((1, 2), [(2, 2)]), edges((2, 3), [(4, 4)])]
    matches, geometries = renumber(tuple(m for m, _ in pairs), tuple(g for _, g in pairs), (0, 2, 3))
    assert [m.pair for m in matches] == [(0, 1), (1, 2)]
    assert [g.pair for g in geometries] == [(0, 1), (1, 2)]
