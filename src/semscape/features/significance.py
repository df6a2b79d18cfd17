"""Keep the keypoints that are worth matching: scored once per image by a trained model, or by a cheap rule."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.errors import BadInputError
from semscape.features.traits import keypoint_traits
from semscape.options import FeaturesOptions
from semscape.types import FloatArray, IntArray, Keypoints, Micrograph, _Value

_BLOCK = 256


@dataclass(frozen=True)
class SignificanceModel:
    """What scores keypoints.

    Parameters
    ----------
    groups : tuple of str
        Groups of traits that it wants, keys of `semscape.features.traits.TRAITS`.
    probability : callable
        From traits (N, F) float32 to the probability (N,) that a keypoint is significant.
    """

    groups: tuple[str, ...]
    probability: Callable[[NDArray[np.float32]], FloatArray]


@dataclass(frozen=True, eq=False)
class TreeEnsemble(_Value):
    """Boosted trees as flat arrays: the log-odds of a row is `baseline` plus the value of one leaf per tree.

    Node k is a leaf where `feature[k]` is -1; else a row goes to `left[k]` if its feature is at most `threshold[k]`,
    or, where that is NaN, if `missing_left[k]`, else to `right[k]`. Children stand behind their parent.

    Raises
    ------
    ValueError
        If a child does not stand behind its parent, or an index points outside: such trees might never end.
    """

    feature: NDArray[np.int32]
    threshold: FloatArray
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    missing_left: NDArray[np.bool_]
    value: FloatArray
    roots: NDArray[np.int32]
    baseline: float
    n_features: int

    def __post_init__(self) -> None:
        super().__post_init__()
        n, inner = len(self.feature), self.feature >= 0
        parent = np.arange(n)[inner]
        children = np.concatenate([self.left[inner], self.right[inner]])
        sound = (
            all(len(array) == n for array in (self.threshold, self.left, self.right, self.missing_left, self.value))
            and (children > np.tile(parent, 2)).all()
            and (children < n).all()
            and (self.feature < self.n_features).all()
            and ((self.roots >= 0) & (self.roots < n)).all()
        )
        if not sound:
            raise ValueError(f"the {len(self.roots)} trees of {n} nodes are not sound")

    def log_odds(self, traits: NDArray[np.float32]) -> FloatArray:
        """Return the log-odds (N,) of being significant for rows (N, F) of traits.

        Raises
        ------
        ValueError
            For rows of another length than the trees were trained on.
        """
        if traits.ndim != 2 or traits.shape[1] != self.n_features:
            raise ValueError(f"the model takes {self.n_features} traits, got an array of shape {traits.shape}")
        log_odds = np.full(len(traits), self.baseline)
        columns = np.ascontiguousarray(traits, dtype=np.float32)
        _add_leaves(
            columns, self.feature, self.threshold, self.left, self.right, self.missing_left, self.value, self.roots,
            log_odds,
        )  # fmt: skip
        return log_odds


def keep_significant(
    view: Micrograph, keypoints: Keypoints, options: FeaturesOptions, model: SignificanceModel | None
) -> Keypoints:
    """Return the keypoints of a view that are worth matching, in their order.

    Parameters
    ----------
    view : Micrograph
        The image that the keypoints are of.
    keypoints : Keypoints
    options : FeaturesOptions
        The share to keep, the least probability, and what decides.
    model : SignificanceModel or None
        Needed where the model decides.

    Returns
    -------
    Keypoints
        With `significance` where a model scored them.

    Raises
    ------
    BadInputError
        Where the model shall decide about keypoints other than SIFT's.
    """
    if options.significance_by == "model":
        if model is None:
            raise ValueError("features.significance_by is 'model', and no model was given")
        if keypoints.kind != "sift":
            raise BadInputError(
                f"the model knows SIFT keypoints, not {keypoints.kind.upper()}: set features.significance.by to "
                "response or scale, or leave features.significance.keep at 1"
            )
        score = model.probability(keypoint_traits(view, keypoints, model.groups))
        keypoints = replace(keypoints, significance=score)
        rows = best_rows(score, options.significance_keep)
        rows = rows[score[rows] >= options.significance_threshold]
    else:
        score = keypoints.response if options.significance_by == "response" else keypoints.scale_px
        rows = best_rows(score, options.significance_keep)
    return keypoints_at(keypoints, rows)


def best_rows(score: FloatArray, keep: float) -> IntArray:
    """Return the rows of the best share of scores (N,), in rising order; of equal scores the first rows.

    Examples
    --------
    >>> best_rows(np.array([0.1, 0.9, 0.5, 0.7]), 0.5).tolist()
    [1, 3]
    """
    n_kept = round(keep * len(score))
    if n_kept >= len(score):
        return np.arange(len(score))
    if n_kept == 0:
        return np.arange(0)
    # The least score that is kept, then as many of those equal to it as there is room for.
    limit = np.partition(score, len(score) - n_kept)[len(score) - n_kept]
    above = np.flatnonzero(score > limit)
    equal = np.flatnonzero(score == limit)[: n_kept - len(above)]
    return np.sort(np.concatenate([above, equal]))


def keypoints_at(keypoints: Keypoints, rows: IntArray) -> Keypoints:
    """Return the keypoints of some rows."""
    significance = keypoints.significance
    return Keypoints(
        xy=keypoints.xy[rows],
        scale_px=keypoints.scale_px[rows],
        orientation_rad=keypoints.orientation_rad[rows],
        response=keypoints.response[rows],
        descriptors=keypoints.descriptors[rows],
        kind=keypoints.kind,
        significance=None if significance is None else significance[rows],
    )


@njit(cache=True, nogil=True)
def _add_leaves(
    traits: NDArray[np.float32],
    feature: NDArray[np.int32],
    threshold: FloatArray,
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    missing_left: NDArray[np.bool_],
    value: FloatArray,
    roots: NDArray[np.int32],
    log_odds: FloatArray,
) -> None:  # pragma: no cover - compiled
    # Level by level over a block of rows without a branch: nobody can predict which way a row goes. What has reached
    # its leaf stays there, and a tree is done when nobody has moved.
    node = np.empty(_BLOCK, np.int32)
    leaf = feature < 0
    column = np.where(leaf, 0, feature)
    here = np.arange(len(feature)).astype(np.int32)
    below, above = np.where(leaf, here, left), np.where(leaf, here, right)
    block = np.empty((traits.shape[1], _BLOCK), np.float32)
    for first in range(0, len(traits), _BLOCK):
        n_rows = min(_BLOCK, len(traits) - first)
        block[:, :n_rows] = traits[first : first + n_rows].T
        for root in roots:
            node[:] = root
            moving = True
            while moving:
                moved = 0
                for n in range(n_rows):
                    k = node[n]
                    trait = block[column[k], n]
                    goes_left = (trait <= threshold[k]) | (missing_left[k] & (trait != trait))
                    following = below[k] if goes_left else above[k]
                    moved |= following ^ k
                    node[n] = following
                moving = moved != 0
            for n in range(n_rows):
                log_odds[first + n] += value[node[n]]
