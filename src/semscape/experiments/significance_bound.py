"""How well an image can tell its own keypoints at all: learned from one half of its field, tried on the other.

A classifier that has seen the same specimen in the same images, though not the same place, knows more than one that
has to travel. Where it too stays low, the traits of one image do not show what is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from threadpoolctl import threadpool_limits

from semscape.learning.dataset import Dataset, capped
from semscape.learning.run import SHIPPED_TRAITS
from semscape.learning.validate import Scored
from semscape.types import BoolArray, FloatArray, IntArray

BOUND_COLUMNS = (
    "specimen", "AUC unseen", "AUC unseen, within an image", "AUC from its other half",
    "AUC from its other half, within an image",
)  # fmt: skip
# Shares of the width; what lies between is left out, so that no neighbourhood reaches from one half into the other.
_LEFT, _RIGHT = 0.45, 0.55


def bound_rows(
    dataset: Dataset, width_px: Mapping[str, int], scored: Sequence[Scored], *, seed: int, rows_per_group: int
) -> tuple[tuple[Any, ...], ...]:
    """Return the rows of the table, a specimen each.

    Parameters
    ----------
    dataset : Dataset
    width_px : mapping of str to int
        Width of the images of each group.
    scored : sequence of Scored
        What `semscape.learning.validate.validate` gave for one classifier and unseen specimens.
    seed, rows_per_group : int
        What it was given.
    """
    drawn = capped(dataset, rows_per_group, rng=np.random.default_rng(seed))
    specimen = np.array(dataset.specimen)
    rows = []
    for unseen in scored:
        image = drawn.image[specimen[drawn.group] == unseen.specimen]
        own = dataset.only(specimen[dataset.group] == unseen.specimen)
        place = own.xy[:, 0] / np.array([width_px[name] for name in dataset.groups])[own.group]
        left, right = place < _LEFT, place > _RIGHT
        halves = [_from_other_half(own, *split, seed) for split in ((left, right), (right, left))]
        over_all, within = np.nanmean(halves, axis=0)
        rows.append((unseen.specimen, *_auc(unseen.probability, unseen.significant, image), over_all, within))
    return tuple(rows)


def _from_other_half(own: Dataset, train: BoolArray, test: BoolArray, seed: int) -> tuple[float, float]:
    features = own.columns(SHIPPED_TRAITS)
    # Freer than what ships: it need not travel.
    trees = HistGradientBoostingClassifier(
        learning_rate=0.05,
        max_iter=150,
        max_leaf_nodes=20,
        min_samples_leaf=60,
        l2_regularization=5.0,
        early_stopping=False,
        random_state=seed,
    )
    with threadpool_limits(1):
        trees.fit(_known(features[train]), own.significant[train])
        odds = trees.decision_function(_known(features[test]))
    return _auc(odds, own.significant[test], own.image[test])


def _known(features: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the features with 0 where a trait is unknown everywhere; scikit-learn cannot bin such a one."""
    return np.where(np.isnan(features).all(axis=0), np.float32(0), features)


def _auc(score: FloatArray, significant: BoolArray, image: IntArray) -> tuple[float, float]:
    """Return the AUC of all rows together, and its mean over the images that show both classes."""
    mixed = [rows for rows in (image == each for each in np.unique(image)) if 0 < significant[rows].mean() < 1]
    within = [roc_auc_score(significant[rows], score[rows]) for rows in mixed]
    return float(roc_auc_score(significant, score)), float(np.mean(within)) if within else float("nan")
