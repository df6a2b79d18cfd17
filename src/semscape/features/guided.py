"""A second look along the epipolar lines: matches that the ratio test lost among strangers.

Once the epipolar geometry of a pair is known, a keypoint need not be distinct from all keypoints of the other
view, only from those close to its epipolar line. Under parallel projection the lines of a view are parallel, so
each keypoint has one coordinate across them; sorted by it, those within the band are neighbours in the list.
Along its line a keypoint moves about as far as the inliers around it do.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from semscape.compiled import njit
from semscape.types import BoolArray, FloatArray, IntArray, Keypoints, Matches, TwoViewGeometry

_INLIERS_AROUND = 4


def epipolar_coordinates_px(
    geometry: TwoViewGeometry, xy1: FloatArray, xy2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where points lie across the epipolar lines: equal for points on each other's lines.

    Parameters
    ----------
    geometry : TwoViewGeometry
        Of parallel projections.
    xy1, xy2 : (N1, 2) and (N2, 2) float arrays
        Points of the two views in px.

    Returns
    -------
    (N1,) and (N2,) float arrays
        In px of the view where they are the farther apart, as the residual of a match is.

    Raises
    ------
    ValueError
        When the lines of a view are not parallel.
    """
    matrix = geometry.matrix
    if not is_parallel(geometry):
        raise ValueError(f"the epipolar lines of a {geometry.kind} geometry are not parallel")
    weaker = min(np.hypot(*matrix[2, :2]), np.hypot(*matrix[:2, 2]))
    one: FloatArray = (xy1 @ matrix[2, :2] + matrix[2, 2]) / weaker
    two: FloatArray = -(xy2 @ matrix[:2, 2]) / weaker
    return one, two


def is_parallel(geometry: TwoViewGeometry) -> bool:
    """Tell whether the epipolar lines of each view are parallel, as those of parallel projections are."""
    return bool((geometry.matrix[:2, :2] == 0).all() and geometry.matrix[2, :2].any() and geometry.matrix[:2, 2].any())


def add_guided_matches(
    found: Matches, geometry: TwoViewGeometry, keypoints1: Keypoints, keypoints2: Keypoints, *, ratio: float
) -> tuple[Matches, TwoViewGeometry]:
    """Add the matches that are mutual nearest neighbours and distinct within the band of the epipolar lines.

    The band reaches as far as the geometry's inlier threshold. A match may be no less similar than the least
    similar inlier of `found`, and it moves along its line as far as the four nearest inliers do, give or take the
    threshold: within the band there are too few strangers for the ratio test to keep chance out alone.

    Parameters
    ----------
    found, geometry
        Putative matches of a pair and their geometry, of parallel projections.
    keypoints1, keypoints2 : Keypoints
        Of the two views.
    ratio : float
        Largest ratio of the nearest to the second nearest distance within the band, in (0, 1].

    Returns
    -------
    Matches, TwoViewGeometry
        Those of before with the new matches, all of them inliers, among them; sorted as before.
    """
    one, two = _as_floats(keypoints1.descriptors), _as_floats(keypoints2.descriptors)
    u1, u2 = epipolar_coordinates_px(geometry, keypoints1.xy, keypoints2.xy)
    nearest, squared, second, back = two_nearest_in_band(one, u1, two, u2, geometry.threshold_px)
    inliers = found.indices[geometry.inliers]
    difference = one[inliers[:, 0]] - two[inliers[:, 1]]
    farthest = np.einsum("nd,nd->n", difference, difference).max(initial=0)
    limit = ratio if keypoints1.descriptors.dtype == np.uint8 else ratio * ratio
    rows = np.arange(len(one))
    good = (nearest >= 0) & (squared <= farthest) & (squared < limit * second)
    good[good] = back[nearest[good]] == rows[good]
    good[inliers[:, 0]] = False
    added = np.column_stack([rows[good], nearest[good]])
    # A keypoint of view 2 that an inlier holds stays with it.
    added = added[~np.isin(added[:, 1], inliers[:, 1])]
    added = added[_moves_like_inliers(geometry, keypoints1.xy, keypoints2.xy, inliers, added)]
    return _merged(found, geometry, added, squared[added[:, 0]], np.abs(u1[added[:, 0]] - u2[added[:, 1]]), keypoints1)


def _moves_like_inliers(
    geometry: TwoViewGeometry, xy1: FloatArray, xy2: FloatArray, inliers: IntArray, added: IntArray
) -> BoolArray:
    """Tell which matches move along their epipolar lines as far as the nearest inliers, by the threshold at most."""
    if len(inliers) < _INLIERS_AROUND or len(added) == 0:
        return np.zeros(len(added), dtype=bool)
    across1, across2 = geometry.matrix[2, :2], -geometry.matrix[:2, 2]
    along1 = xy1 @ np.array([-across1[1], across1[0]]) / np.hypot(*across1)
    along2 = xy2 @ np.array([-across2[1], across2[0]]) / np.hypot(*across2)
    moved = along2[inliers[:, 1]] - along1[inliers[:, 0]]
    _, around = cKDTree(xy1[inliers[:, 0]]).query(xy1[added[:, 0]], k=_INLIERS_AROUND)
    own = along2[added[:, 1]] - along1[added[:, 0]]
    low, high = moved[around].min(axis=1), moved[around].max(axis=1)
    like: BoolArray = (own >= low - geometry.threshold_px) & (own <= high + geometry.threshold_px)
    return like


def _merged(
    found: Matches,
    geometry: TwoViewGeometry,
    added: IntArray,
    squared: FloatArray,
    residual_px: FloatArray,
    keypoints1: Keypoints,
) -> tuple[Matches, TwoViewGeometry]:
    described = keypoints1.descriptors
    if described.dtype == np.uint8:
        distance = squared / (8 * described.shape[1])
    else:
        distance = np.sqrt(squared) / float(np.linalg.norm(described[0]))
    indices = np.concatenate([found.indices, added])
    order = np.lexsort((indices[:, 1], indices[:, 0]))
    matches = replace(found, indices=indices[order], distance=np.concatenate([found.distance, distance])[order])
    inliers = np.concatenate([geometry.inliers, np.ones(len(added), bool)])[order]
    return matches, replace(
        geometry, inliers=inliers, residual_px=np.concatenate([geometry.residual_px, residual_px])[order]
    )


def two_nearest_in_band(
    descriptors1: NDArray[np.float32],
    u1: FloatArray,
    descriptors2: NDArray[np.float32],
    u2: FloatArray,
    band: float,
) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
    """Find for each row of `descriptors1` its two nearest among those of `descriptors2` with |u1 - u2| <= band.

    Parameters
    ----------
    descriptors1, descriptors2 : (N1, D) and (N2, D) float32 arrays
        Whole numbers are compared exactly.
    u1, u2 : (N1,) and (N2,) float arrays
        Coordinates.
    band : float
        In the unit of the coordinates.

    Returns
    -------
    nearest : (N1,) int
        Index of the nearest, the lower index wins a tie; -1 where the band is empty.
    squared, second_squared : (N1,) float
        Squared distances to the nearest and the second nearest, infinite where there is none.
    back : (N2,) int
        Index of the nearest in `descriptors1` for each row of `descriptors2`, -1 where the band is empty.
    """
    order1, order2 = np.argsort(u1, kind="stable"), np.argsort(u2, kind="stable")
    nearest, back = np.full(len(u1), -1), np.full(len(u2), -1)
    squared = np.full((len(u1), 2), np.inf)
    _search_band(
        descriptors1[order1], u1[order1], order1, descriptors2[order2], u2[order2], order2, band, nearest, squared, back
    )
    return nearest, squared[:, 0], squared[:, 1], back


# The sums of whole numbers are exact in any order, so the compiler may choose one.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _squared_distance(one: NDArray[np.float32], two: NDArray[np.float32]) -> Any:  # pragma: no cover - compiled
    total = np.float32(0)
    for k in range(len(one)):
        difference = one[k] - two[k]
        total += difference * difference
    return total


@njit(cache=True, nogil=True)
def _search_band(
    descriptors1: NDArray[np.float32],
    u1: FloatArray,
    order1: IntArray,
    descriptors2: NDArray[np.float32],
    u2: FloatArray,
    order2: IntArray,
    band: float,
    nearest: IntArray,
    squared: FloatArray,
    back: IntArray,
) -> None:  # pragma: no cover - compiled
    """Search with everything sorted by u; the last three arrays are in the order of the keypoints."""
    back_squared = np.full(len(u2), np.inf)
    first = 0
    for row in range(len(u1)):
        i = order1[row]
        while first < len(u2) and u1[row] - u2[first] > band:
            first += 1
        column = first
        while column < len(u2) and u2[column] - u1[row] <= band:
            j = order2[column]
            distance = _squared_distance(descriptors1[row], descriptors2[column])
            if distance < squared[i, 0] or (distance == squared[i, 0] and j < nearest[i]):
                squared[i, 1] = squared[i, 0]
                squared[i, 0] = distance
                nearest[i] = j
            elif distance < squared[i, 1]:
                squared[i, 1] = distance
            if distance < back_squared[j] or (distance == back_squared[j] and i < back[j]):
                back_squared[j] = distance
                back[j] = i
            column += 1


def _as_floats(descriptors: NDArray[Any]) -> NDArray[np.float32]:
    """Return float descriptors as they are, binary ones as zeros and ones, whose squared distance is Hamming's."""
    if descriptors.dtype != np.uint8:
        return descriptors
    return np.unpackbits(descriptors, axis=1).astype(np.float32)
