"""Which pairs of views share a scene, and which views hang together through such pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from semscape.errors import TooFewMatchesError
from semscape.features.guided import add_guided_matches, is_parallel
from semscape.features.match import match
from semscape.options import FeaturesOptions, RobustOptions
from semscape.robust.pair_geometry import two_view_geometry
from semscape.types import FloatArray, Keypoints, Matches, TwoViewGeometry

Pair = tuple[int, int]


def match_pair(
    pair: Pair,
    keypoints: tuple[Keypoints, ...],
    names: tuple[str, ...],
    shape: tuple[int, int],
    features: FeaturesOptions,
    robust: RobustOptions,
    rng: np.random.Generator,
    calibrations: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[Matches, TwoViewGeometry]:
    """Match two views, estimate their epipolar geometry, and with `features.guided` match again along its lines.

    An essential matrix (`robust.model`) needs the views' calibrations.

    Raises
    ------
    TooFewMatchesError
        When the a contrario method finds no meaningful geometry, or one with too few inliers.
    """
    i1, i2 = pair
    found = match(pair, keypoints[i1], keypoints[i2], ratio=features.ratio)
    between = f"between {names[i1]} and {names[i2]}"
    if len(found) < robust.min_inliers:
        raise TooFewMatchesError(f"{len(found)} matches {between}, need {robust.min_inliers}")
    xy1 = keypoints[i1].xy[found.indices[:, 0]]
    xy2 = keypoints[i2].xy[found.indices[:, 1]]
    geometry = two_view_geometry(
        pair,
        xy1,
        xy2,
        kind=robust.model,
        parallax_limited=robust.limit_parallax,
        shapes=(shape, shape),
        rng=rng,
        max_trials=robust.max_trials,
        calibrations=calibrations,
    )
    n_inliers = int(geometry.inliers.sum())
    if geometry.log10_nfa >= 0 or n_inliers < robust.min_inliers:
        raise TooFewMatchesError(
            f"{n_inliers} of {len(found)} matches {between} fit one epipolar geometry (log10 NFA "
            f"{geometry.log10_nfa:.1f}), need {robust.min_inliers} and a negative log10 NFA"
        )
    if features.guided and is_parallel(geometry):
        return add_guided_matches(found, geometry, keypoints[i1], keypoints[i2], ratio=features.ratio)
    return found, geometry


def largest_connected_set(pairs: list[Pair], n_views: int) -> tuple[int, ...]:
    """Return the views of the largest set that the pairs join; of equal ones the first.

    Examples
    --------
    >>> largest_connected_set([(0, 2), (2, 3)], 4)
    (0, 2, 3)
    """
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(pairs)), (first, second)), shape=(n_views, n_views))
    _, label = connected_components(graph, directed=False)
    return tuple(int(view) for view in np.flatnonzero(label == np.bincount(label).argmax()))


def renumber(
    matches: tuple[Matches, ...], geometries: tuple[TwoViewGeometry, ...], kept: tuple[int, ...]
) -> tuple[tuple[Matches, ...], tuple[TwoViewGeometry, ...]]:
    """Keep the pairs whose views are both kept, with the views numbered anew."""
    new = {view: index for index, view in enumerate(kept)}
    chosen = [
        (replace(found, pair=pair), replace(geometry, pair=pair))
        for found, geometry in zip(matches, geometries, strict=True)
        if found.pair[0] in new and found.pair[1] in new
        for pair in [(new[found.pair[0]], new[found.pair[1]])]
    ]
    return tuple(found for found, _ in chosen), tuple(geometry for _, geometry in chosen)
