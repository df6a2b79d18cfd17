"""The classifiers: the thesis's four with the defaults of Weka 3.6, and two that an engineer takes today.

Those two are gradient boosting, and a blend of logistic regression with boosted trees that may only rise, or only fall,
with a trait whose sense physics tells. A straight line goes on where nothing was seen to learn from, trees follow what
bends; their mean log-odds travel to an unseen specimen better than either.
"""

# Every classifier is made from the names of its features and the seed; some need neither.
# ruff: noqa: ARG001

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.impute import SimpleImputer
from sklearn.linear_model import LogisticRegression
from sklearn.naive_bayes import GaussianNB
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import LinearSVC
from threadpoolctl import threadpool_limits

from semscape.features.traits import SENSE
from semscape.types import BoolArray, FloatArray

_RIDGE = 1e-8


def _filled(*steps: Any) -> Any:
    """Put the mean where a trait is unknown; Weka does so too."""
    return make_pipeline(SimpleImputer(keep_empty_features=True), *steps)


def _naive_bayes(names: Sequence[str], seed: int) -> Any:
    return _filled(GaussianNB())


def _random_forest(names: Sequence[str], seed: int) -> Any:
    width = min(int(math.log2(len(names))) + 1, len(names))
    return _filled(RandomForestClassifier(10, max_features=width, max_depth=None, random_state=seed))


def _logistic(names: Sequence[str], seed: int) -> Any:
    # Weka adds ridge |w|^2 to the negative log-likelihood, scikit-learn |w|^2 / (2 C).
    return _filled(StandardScaler(), LogisticRegression(C=1 / (2 * _RIDGE), max_iter=200))


def _svm(names: Sequence[str], seed: int) -> Any:
    # SMO with a polynomial kernel of degree 1 is the linear soft-margin SVM: the same problem, solved in the dual by
    # coordinates instead of pairs. The large intercept scale keeps the intercept almost unpenalized, as in SMO.
    machine = LinearSVC(C=1.0, loss="hinge", dual=True, intercept_scaling=10.0, max_iter=400, random_state=seed)
    return _filled(MinMaxScaler(), machine)


def _boosting(names: Sequence[str], seed: int) -> Any:
    # Shallow trees: to score 30,000 keypoints must cost little beside matching them.
    return HistGradientBoostingClassifier(
        learning_rate=0.13,
        max_iter=60,
        max_leaf_nodes=12,
        max_depth=4,
        min_samples_leaf=100,
        l2_regularization=10.0,
        early_stopping=False,
        random_state=seed,
    )


def _blend(names: Sequence[str], seed: int) -> Any:
    trees = HistGradientBoostingClassifier(
        learning_rate=0.2,
        max_iter=40,
        max_leaf_nodes=8,
        max_depth=3,
        min_samples_leaf=100,
        l2_regularization=10.0,
        monotonic_cst=[SENSE.get(name, 0) for name in names],
        early_stopping=False,
        random_state=seed,
    )
    return [_logistic(names, seed), trees]


CLASSIFIERS: Mapping[str, Callable[[Sequence[str], int], Any]] = MappingProxyType(
    {
        "naive_bayes": _naive_bayes,
        "random_forest": _random_forest,
        "logistic": _logistic,
        "svm": _svm,
        "boosting": _boosting,
        "blend": _blend,
    }
)


def fitted(
    name: str,
    features: NDArray[np.float32],
    significant: BoolArray,
    *,
    names: Sequence[str],
    group: NDArray[Any],
    seed: int,
) -> Any:
    """Return a classifier of `CLASSIFIERS` trained on rows (N, F), or the list of those that make a blend.

    Gradient boosting, and the logistic regression of the blend, give each class of each group the same weight, so that
    they learn to rank the keypoints of an image and not to tell easy specimens from hard ones; their probabilities are
    those at even odds. The trees of the blend and the thesis's four take the rows as they are.

    Parameters
    ----------
    name : str
    features : (N, F) float32 array
    significant : (N,) bool array
    names : sequence of str
        Of the F features.
    group : (N,) int array
    seed : int

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if name not in CLASSIFIERS:
        raise ValueError(f"classifier {name!r} is unknown, known are {', '.join(CLASSIFIERS)}")
    estimator = CLASSIFIERS[name](names, seed)
    # scikit-learn cannot bin a trait that is unknown everywhere.
    known = np.where(np.isnan(features).all(axis=0), np.float32(0), features)
    # Threads of scikit-learn's trees wait for each other in turns; on a machine that does more it takes them minutes.
    with threadpool_limits(1), warnings.catch_warnings():
        # With hardly a ridge, and in the SVM's dual, the last digits creep; they are far below what folds differ.
        warnings.simplefilter("ignore", ConvergenceWarning)
        if name == "boosting":
            return estimator.fit(known, significant, sample_weight=_alike(group, significant))
        if name == "blend":
            line, trees = estimator
            line.fit(features, significant, logisticregression__sample_weight=_alike(group, significant))
            return [line, trees.fit(known, significant)]
        return estimator.fit(features, significant)


def _alike(group: NDArray[Any], significant: BoolArray) -> FloatArray:
    """Return weights (N,), 1 in the mean, that make each class of each group count the same."""
    cell = 2 * group + significant
    share = 1 / np.bincount(cell)[cell]
    weight: FloatArray = share / share.mean()
    return weight


def probability(estimator: Any, features: NDArray[np.float32]) -> FloatArray:
    """Return the probability (N,) of being significant; of an SVM the logistic function of its margin."""
    with threadpool_limits(1):
        if isinstance(estimator, list):
            mean: FloatArray = expit(np.mean([each.decision_function(features) for each in estimator], axis=0))
            return mean
        if hasattr(estimator, "predict_proba"):
            positive: FloatArray = np.asarray(estimator.predict_proba(features)[:, 1], dtype=np.float64)
            return positive
        squashed: FloatArray = expit(estimator.decision_function(features))
        return squashed
