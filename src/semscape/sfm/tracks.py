"""Join pairwise matches into tracks: one world point seen in several views."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from semscape.types import FloatArray, IntArray, Keypoints, Matches, Observations, TwoViewGeometry


def build_tracks(
    keypoints: tuple[Keypoints, ...], matches: tuple[Matches, ...], geometries: tuple[TwoViewGeometry, ...]
) -> Observations:
    """Join the inliers of all pairs by union-find.

    Tracks that hold two keypoints of one view contradict themselves and are dropped, and of keypoints at
    one place (the same point with two orientations) only one makes a track.

    Parameters
    ----------
    keypoints : V Keypoints
    matches, geometries
        One of each per pair, in the same order.

    Returns
    -------
    Observations
        At least two per point, sorted by point, then view.
    """
    first = np.concatenate([[0], np.cumsum([len(item) for item in keypoints])])
    total = int(first[-1])
    rows, columns = _inlier_edges(first, matches, geometries)
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(total, total))
    _, component = connected_components(graph, directed=False)

    view = np.repeat(np.arange(len(keypoints)), np.diff(first))
    size = np.bincount(component)
    distinct_views = np.zeros(len(size), dtype=np.int64)
    np.add.at(distinct_views, np.unique(component * len(keypoints) + view) // len(keypoints), 1)
    good = (size >= 2) & (size == distinct_views)

    node = np.flatnonzero(good[component])
    node = node[np.lexsort((view[node], component[node]))]
    xy = np.concatenate([item.xy for item in keypoints])[node]
    return _without_repeats(view[node], component[node], xy)


def _inlier_edges(
    first: IntArray, matches: tuple[Matches, ...], geometries: tuple[TwoViewGeometry, ...]
) -> tuple[IntArray, IntArray]:
    rows, columns = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for found, geometry in zip(matches, geometries, strict=True):
        i1, i2 = found.pair
        kept = found.indices[geometry.inliers]
        rows.append(first[i1] + kept[:, 0])
        columns.append(first[i2] + kept[:, 1])
    return np.concatenate(rows), np.concatenate(columns)


def _without_repeats(view: IntArray, component: IntArray, xy: FloatArray) -> Observations:
    """Give the tracks their numbers, keeping one of those that see the same place in their first view."""
    _, start, point = np.unique(component, return_index=True, return_inverse=True)
    place = np.column_stack([view[start], np.rint(xy[start] * 100)])
    _, kept_tracks = np.unique(place, axis=0, return_index=True)
    keep = np.isin(point, kept_tracks)
    _, point = np.unique(point[keep], return_inverse=True)
    return Observations(view[keep].astype(np.int64), point.astype(np.int64), xy[keep])
