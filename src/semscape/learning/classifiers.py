"""The classifiers: the thesis's four with the defaults of Weka 3.6, and the one that an engineer takes today."""

# Every classifier is made from the number of features and the seed; some need neither.
# ruff: noqa: ARG001

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
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

from semscape.types import BoolArray, FloatArray

_RIDGE = 1e-8


def _filled(*steps: Any) -> Any:
    """Put the mean where a trait is unknown; Weka does so too."""
    return make_pipeline(SimpleImputer(keep_empty_features=True), *steps)


def _naive_bayes(n_features: int, seed: int) -> Any:
    return _filled(GaussianNB())


def _random_forest(n_features: int, seed: int) -> Any:
    width = min(int(math.log2(n_features)) + 1, n_features)
    return _filled(RandomForestClassifier(10, max_features=width, max_depth=None, random_state=seed))


def _logistic(n_features: int, seed: int) -> Any:
    # Weka adds ridge |w|^2 to the negative log-likelihood, scikit-learn |w|^2 / (2 C).
    return _filled(StandardScaler(), LogisticRegression(C=1 / (2 * _RIDGE), max_iter=200))


def _svm(n_features: int, seed: int) -> Any:
    # SMO with a polynomial kernel of degree 1 is the linear soft-margin SVM: the same problem, solved in the dual by
    # coordinates instead of pairs. The large intercept scale keeps the intercept almost unpenalized, as in SMO.
    machine = LinearSVC(C=1.0, loss="hinge", dual=True, intercept_scaling=10.0, max_iter=400, random_state=seed)
    return _filled(MinMaxScaler(), machine)


def _boosting(n_features: int, seed: int) -> Any:
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


CLASSIFIERS: Mapping[str, Callable[[int, int], Any]] = MappingProxyType(
    {
        "naive_bayes": _naive_bayes,
        "random_forest": _random_forest,
        "logistic": _logistic,
        "svm": _svm,
        "boosting": _boosting,
    }
)


def fitted(name: str, features: NDArray[np.float32], significant: BoolArray, *, group: NDArray[Any], seed: int) -> Any:
    """Return a classifier of `CLASSIFIERS` trained on rows (N, F).

    Gradient boosting gives each class of each group the same weight, so that it learns to rank the keypoints of an
    image and not to tell easy specimens from hard ones; its probabilities are those at even odds. The thesis's four
    take the rows as they are.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if name not in CLASSIFIERS:
        raise ValueError(f"classifier {name!r} is unknown, known are {', '.join(CLASSIFIERS)}")
    estimator = CLASSIFIERS[name](features.shape[1], seed)
    if name == "boosting":
        # scikit-learn cannot bin a trait that is unknown everywhere.
        features = np.where(np.isnan(features).all(axis=0), np.float32(0), features)
        cell = 2 * group + significant
        weight = 1 / np.bincount(cell)[cell]
        return estimator.fit(features, significant, sample_weight=weight * len(weight) / weight.sum())
    with warnings.catch_warnings():
        # With hardly a ridge, and in the SVM's dual, the last digits creep; they are far below what folds differ.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(features, significant)


def probability(estimator: Any, features: NDArray[np.float32]) -> FloatArray:
    """Return the probability (N,) of being significant; of an SVM the logistic function of its margin."""
    if hasattr(estimator, "predict_proba"):
        positive: FloatArray = np.asarray(estimator.predict_proba(features)[:, 1], dtype=np.float64)
        return positive
    squashed: FloatArray = expit(estimator.decision_function(features))
    return squashed
