"""How well an image can tell its own keypoints at all: learned from one half of its field, tried on the other.

A classifier that has seen the same specimen in the same images, though not the same place, knows more than one that
has to travel. Where it too stays low, the traits of one image do not show what is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from threadpoolctl import threadpool_limits

from semscape.features.significance import best_rows
from semscape.learning.dataset import Dataset, capped
from semscape.learning.run import SHIPPED_TRAITS
from semscape.learning.validate import Scored
from semscape.types import BoolArray, FloatArray, IntArray

_FIGURES = ("AUC", "AUC within an image", "significant in the better half")
BOUND_COLUMNS = (
    "specimen", *(f"{name}, {model}" for model in ("unseen", "from its other half") for name in _FIGURES)
)  # fmt: skip
# Shares of the width; what lies between is left out, so that no neighbourhood reaches from one half into the other.
_LEFT, _RIGHT = 0.45, 0.55


def bound_rows(
    dataset: Dataset, width_px: Mapping[str, int], scored: Sequence[Scored], *, seed: int, rows_per_group: int
) -> tuple[tuple[Any, ...], ...]:
    """Return the rows of the table: a specimen each, and each of its groups where it has several.

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
    rows: list[tuple[Any, ...]] = []
    for unseen in scored:
        groups = np.flatnonzero(specimen == unseen.specimen)
        image, group = (each[np.isin(drawn.group, groups)] for each in (drawn.image, drawn.group))
        own = dataset.only(np.isin(dataset.group, groups))
        place = own.xy[:, 0] / np.array([width_px[name] for name in dataset.groups])[own.group]
        left, right = place < _LEFT, place > _RIGHT
        splits = ((left, right), (right, left))
        halves = [(own.only(test), _odds(own.only(train), own.only(test), seed)) for train, test in splits]
        several = [(dataset.groups[each], np.array([each])) for each in groups] if len(groups) > 1 else []
        for name, of in ((unseen.specimen, groups), *several):
            told = _figures(unseen.probability, unseen.significant, image, np.isin(group, of))
            bound = [_figures(odds, test.significant, test.image, np.isin(test.group, of)) for test, odds in halves]
            rows.append((name, *told, *np.mean(bound, axis=0).tolist()))
    return tuple(rows)


def _odds(train: Dataset, test: Dataset, seed: int) -> FloatArray:
    """Return the log-odds (N,) of the test's keypoints by a classifier that is trained on the other half's."""
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
        trees.fit(train.columns(SHIPPED_TRAITS), train.significant)
        odds: FloatArray = trees.decision_function(test.columns(SHIPPED_TRAITS))
    return odds


def _figures(score: FloatArray, significant: BoolArray, image: IntArray, of: BoolArray) -> tuple[float, float, float]:
    """Return the AUC of some rows together, its mean over their images, and how many of an image's are kept by half.

    Images that show one class alone are left out of the means.
    """
    within, kept = [], []
    for each in np.unique(image[of]):
        rows = np.flatnonzero(of & (image == each))
        if 0 < significant[rows].mean() < 1:
            within.append(roc_auc_score(significant[rows], score[rows]))
            kept.append(significant[rows[best_rows(score[rows], 0.5)]].sum() / significant[rows].sum())
    if not within:
        return np.nan, np.nan, np.nan
    return float(roc_auc_score(significant[of], score[of])), float(np.mean(within)), float(np.mean(kept))
