"""Validation summary of the classifiers (thesis 3.7) under two protocols.

`pooled`: ten folds over all keypoints, shuffled. It leaks: the same point of the surface, seen in another image,
lies in the training folds too, so it flatters whoever memorizes. `unseen`: each specimen in turn is left out of
training altogether. That is what a user meets, and the figure to believe.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import StratifiedKFold

from semscape.errors import BadInputError
from semscape.features.traits import trait_names
from semscape.learning.classifiers import fitted, probability
from semscape.learning.dataset import Dataset, capped
from semscape.types import BoolArray, FloatArray, IntArray, _Value

PROTOCOLS = ("pooled", "unseen")
_FOLDS = 10


@dataclass(frozen=True, eq=False)
class Scored(_Value):
    """Probabilities (N,) that a classifier gave to keypoints it was not trained on, and their true class (N,)."""

    classifier: str
    protocol: str
    specimen: str
    probability: FloatArray
    significant: BoolArray
    train_s: float
    score_s: float


@dataclass(frozen=True)
class Summary:
    """One row of the validation summary; `majority` is the accuracy of always saying the commoner class."""

    classifier: str
    protocol: str
    specimen: str
    n: int
    majority: float
    accuracy: float
    precision: float
    recall: float
    f1: float
    auc: float
    true_positive: int
    false_positive: int
    false_negative: int
    true_negative: int
    train_s: float
    score_us_per_keypoint: float

    def row(self) -> tuple[Any, ...]:
        """Return the values in the order of the fields."""
        return tuple(asdict(self).values())


def summarize(scored: Scored) -> Summary:
    """Return the figures of some scored keypoints; what was scored at least 0.5 is called significant.

    Examples
    --------
    >>> truth = np.array([True, True, False, False])
    >>> result = summarize(Scored("svm", "unseen", "a", np.array([0.9, 0.4, 0.6, 0.1]), truth, 1.0, 0.0))
    >>> result.accuracy, result.recall, result.auc, result.majority
    (0.5, 0.5, 0.75, 0.5)
    """
    truth, said = scored.significant, scored.probability >= 0.5
    n = len(truth)
    tp, fp = int((said & truth).sum()), int((said & ~truth).sum())
    fn, tn = int((~said & truth).sum()), int((~said & ~truth).sum())
    return Summary(
        classifier=scored.classifier,
        protocol=scored.protocol,
        specimen=scored.specimen,
        n=n,
        majority=float(max(truth.mean(), 1 - truth.mean())),
        accuracy=(tp + tn) / n,
        precision=tp / (tp + fp) if tp + fp else float("nan"),
        recall=tp / (tp + fn) if tp + fn else float("nan"),
        f1=2 * tp / (2 * tp + fp + fn) if tp + fp + fn else float("nan"),
        auc=float(roc_auc_score(truth, scored.probability)) if 0 < truth.sum() < n else float("nan"),
        true_positive=tp,
        false_positive=fp,
        false_negative=fn,
        true_negative=tn,
        train_s=scored.train_s,
        score_us_per_keypoint=1e6 * scored.score_s / n,
    )


def validate(
    dataset: Dataset,
    classifiers: Sequence[str],
    trait_groups: Sequence[str],
    *,
    protocol: str,
    seed: int,
    rows_per_group: int,
    left_out: Sequence[str] | None = None,
) -> Iterator[Scored]:
    """Score keypoints by classifiers that were not trained on them.

    Parameters
    ----------
    dataset : Dataset
    classifiers : sequence of str
        Names of `semscape.learning.classifiers.CLASSIFIERS`.
    trait_groups : sequence of str
        Groups of traits to learn from.
    protocol : str
        "pooled": one result per classifier, over ten folds. "unseen": one per classifier and specimen.
    seed : int
    rows_per_group : int
        Every group is cut down at random to so many keypoints, for training and test alike.
    left_out : sequence of str, optional
        The specimens to leave out in turn; all of them if not given.

    Yields
    ------
    Scored

    Raises
    ------
    BadInputError
        When the dataset holds one specimen alone and the protocol is "unseen".
    """
    dataset = capped(dataset, rows_per_group, rng=np.random.default_rng(seed))
    features, traits = dataset.columns(trait_groups), trait_names(trait_groups)
    specimen = np.array(dataset.specimen)[dataset.group]
    for name in classifiers:
        if protocol == "pooled":
            folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=seed).split(features, dataset.significant)
            yield _score(name, protocol, "all", dataset, features, traits, list(folds), seed)
            continue
        for other in left_out or sorted(set(specimen)):
            test = specimen == other
            if test.all() or not test.any():
                raise BadInputError(f"the dataset holds {str(other)!r} alone or not at all; another specimen is needed")
            split = (np.flatnonzero(~test), np.flatnonzero(test))
            yield _score(name, protocol, other, dataset, features, traits, [split], seed)


def _score(
    name: str,
    protocol: str,
    specimen: str,
    dataset: Dataset,
    features: NDArray[np.float32],
    names: tuple[str, ...],
    splits: list[tuple[IntArray, IntArray]],
    seed: int,
) -> Scored:
    scores, rows = [], []
    train_s = score_s = 0.0
    for train, test in splits:
        start = time.process_time()
        known, group = dataset.significant[train], dataset.group[train]
        estimator = fitted(name, features[train], known, names=names, group=group, seed=seed)
        trained = time.process_time()
        scores.append(probability(estimator, features[test]))
        rows.append(test)
        train_s += trained - start
        score_s += time.process_time() - trained
    order = np.concatenate(rows)
    return Scored(name, protocol, specimen, np.concatenate(scores), dataset.significant[order], train_s, score_s)
