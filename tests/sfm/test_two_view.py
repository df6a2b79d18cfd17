"""Matching and geometry of a pair: the second pass only adds, and only where lines are parallel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.options import FeaturesOptions, RobustOptions
from semscape.sfm import two_view
from semscape.sfm.two_view import match_pair
from semscape.types import Keypoints, Matches, TwoViewGeometry

SHAPE = (400, 400)


def two_views() -> tuple[Keypoints, Keypoints]:
    """Return two parallel projections of random points, of which fifty have a twin elsewhere."""
    rng = np.random.default_rng(2)
    n = 300
    points = rng.uniform(-150, 150, (n, 3)) * [1, 1, 0.2]
    described = rng.integers(0, 200, (n, 32)).astype(np.float32)
    described[-50:] = described[:50]
    one = np.ones(n)
    views = []
    for tilt in (0.0, 0.15):
        xy = np.column_stack([points[:, 0] * np.cos(tilt) + points[:, 2] * np.sin(tilt), points[:, 1]]) + 200
        noisy = described + rng.integers(-1, 2, described.shape).astype(np.float32)
        views.append(Keypoints(xy + rng.normal(0, 0.05, xy.shape), one, one, one, noisy, "sift"))
    return views[0], views[1]


def matched(guided: bool) -> tuple[Matches, TwoViewGeometry]:
    features = FeaturesOptions(guided=guided)
    return match_pair((0, 1), two_views(), ("a", "b"), SHAPE, features, RobustOptions(), np.random.default_rng(0))


def test_the_second_pass_adds_right_matches_and_keeps_those_of_the_first() -> None:
    first, first_geometry = matched(guided=False)
    both, geometry = matched(guided=True)
    before = {tuple(row) for row in first.indices[first_geometry.inliers].tolist()}
    after = {tuple(row) for row in both.indices[geometry.inliers].tolist()}
    assert before < after
    assert len(after) > len(before) + 20
    assert all(i == j for i, j in after)
    np.testing.assert_array_equal(geometry.matrix, first_geometry.matrix)
    assert (geometry.residual_px[geometry.inliers] <= geometry.threshold_px).all()
    assert (np.diff(both.indices[:, 0]) >= 0).all()


def test_lines_that_are_not_parallel_are_matched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first, geometry = matched(guided=False)
    matrix = geometry.matrix.copy()
    matrix[0, 0] = 1e-7
    bent = replace(geometry, matrix=matrix, kind="fundamental")
    monkeypatch.setattr(two_view, "two_view_geometry", lambda *_, **__: bent)
    again, _ = matched(guided=True)
    np.testing.assert_array_equal(again.indices, first.indices)
