"""A trained model as bytes and back, by skops: reading a model file runs nothing that the file brings along.

A pickle runs whatever its author wrote. A skops file is read against the list `TRUSTED_TYPES`; one that names any
other type is refused.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit
from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.impute import SimpleImputer
from sklearn.linear_model import LogisticRegression
from sklearn.naive_bayes import GaussianNB
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import LinearSVC
from skops.io import dumps, get_untrusted_types, loads

from semscape.errors import BadInputError
from semscape.features.significance import SignificanceModel, TreeEnsemble
from semscape.features.traits import TRAITS, trait_names
from semscape.io.learning_files import read_model_file
from semscape.learning.classifiers import probability
from semscape.types import FloatArray

FORMAT = "semscape-significance-1"
# Beside what skops itself trusts, scikit-learn's public estimators: NumPy's types and the trees of the two forests.
TRUSTED_TYPES = (
    "numpy.dtype",
    "sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",
    "sklearn.tree._tree.Tree",
)
_FILLERS = (SimpleImputer, StandardScaler, MinMaxScaler)
_DECIDERS = (GaussianNB, RandomForestClassifier, LogisticRegression, LinearSVC)


@dataclass(frozen=True)
class TrainedModel:
    """A classifier, or a list of those blended; the groups of traits that it takes; its origin in plain values."""

    estimator: Any
    groups: tuple[str, ...]
    origin: Mapping[str, Any] = field(default_factory=dict)


def model_bytes(model: TrainedModel) -> bytes:
    """Return the bytes of a model's file, the same for the same model."""
    content = {
        "format": FORMAT,
        "groups": list(model.groups),
        "origin": dict(model.origin),
        "estimator": model.estimator,
    }
    return _numbered(dumps(content))


def _numbered(packed: bytes) -> bytes:
    """Return a skops archive whose objects are numbered as they come.

    skops numbers them, and the files of their arrays, by their place in memory, and stamps the files with the time.
    """
    order: dict[int, int] = {}
    files: dict[str, str] = {}

    def number(node: dict[str, Any]) -> dict[str, Any]:
        if "__id__" in node:
            node["__id__"] = order.setdefault(node["__id__"], len(order))
        if "__loader__" in node and "file" in node:
            node["file"] = files.setdefault(node["file"], f"{len(files)}{PurePath(node['file']).suffix}")
        return node

    whole = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(packed)) as old, zipfile.ZipFile(whole, "w") as new:
        schema = json.dumps(json.loads(old.read("schema.json"), object_hook=number), indent=1).encode()
        for name, content in ((name, old.read(old_name)) for old_name, name in files.items()):
            new.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)
        new.writestr(zipfile.ZipInfo("schema.json"), schema, zipfile.ZIP_DEFLATED, 9)
    return whole.getvalue()


def read_model(data: bytes, name: str) -> TrainedModel:
    """Return the model of a file's bytes.

    Parameters
    ----------
    data : bytes
    name : str
        Of the file, for messages.

    Raises
    ------
    BadInputError
        For a file that is no model of semscape's, that holds a type beyond `TRUSTED_TYPES`, or that cannot score.
    """
    try:
        unknown = sorted(set(get_untrusted_types(data=data)) - set(TRUSTED_TYPES))
    except Exception as error:
        raise BadInputError(f"{name} is not a model that semscape train wrote: {error}") from error
    if unknown:
        raise BadInputError(
            f"{name} holds types that a model has no use for ({', '.join(unknown[:3])}); it was not opened. "
            "Train a model with semscape train"
        )
    try:
        content = loads(data, trusted=list(TRUSTED_TYPES))
    except Exception as error:
        raise BadInputError(f"{name} cannot be read, perhaps another scikit-learn wrote it: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BadInputError(f"{name} is not a model that semscape train wrote; its format is not {FORMAT}")
    groups, estimator, origin = (content.get(key) for key in ("groups", "estimator", "origin"))
    if not (isinstance(groups, list) and groups and all(isinstance(group, str) for group in groups)):
        raise BadInputError(f"{name} does not say which groups of traits it takes; train a model with semscape train")
    if not set(groups) <= set(TRAITS):
        raise BadInputError(f"{name} asks for groups of traits that are not known: {', '.join(groups)}")
    model = TrainedModel(estimator, tuple(groups), origin if isinstance(origin, dict) else {})
    try:
        _require_sound(estimator)
        trial = significance_model(model).probability(np.zeros((2, len(trait_names(groups))), np.float32))
    except Exception as error:
        raise BadInputError(f"{name} cannot score keypoints: {error}; train a model with semscape train") from error
    if trial.shape != (2,) or not np.isfinite(trial).all():
        raise BadInputError(f"{name} gives no probabilities; train a model with semscape train")
    return model


def _require_sound(estimator: Any) -> None:
    """Raise for what `semscape.learning.classifiers` does not make, and for trees that may never end.

    scikit-learn walks the trees of a forest without looking; boosted ones are checked where they are flattened.
    """
    if isinstance(estimator, list) and estimator and not any(isinstance(each, list) for each in estimator):
        for each in estimator:
            _require_sound(each)
        return
    if type(estimator) is HistGradientBoostingClassifier:
        return
    steps = [step for _, step in estimator.steps] if type(estimator) is Pipeline else [estimator]
    if len(steps) < 2 or not all(type(step) in _FILLERS for step in steps[:-1]) or type(steps[-1]) not in _DECIDERS:
        raise ValueError(f"it is made of {', '.join(type(step).__name__ for step in steps)}")
    for tree in (each.tree_ for each in getattr(steps[-1], "estimators_", ())):
        parent = np.flatnonzero(tree.children_left >= 0)
        children = np.concatenate([tree.children_left[parent], tree.children_right[parent]])
        ahead = (children > np.tile(parent, 2)) & (children < tree.node_count)
        if not (ahead.all() and (tree.feature[parent] < tree.n_features).all() and (tree.feature[parent] >= 0).all()):
            raise ValueError(f"a tree of {tree.node_count} nodes is not sound")


def load_significance_model(path: str) -> SignificanceModel:
    """Return what scores keypoints from a model file, or where `path` is empty from the model that ships.

    Raises
    ------
    BadInputError
        As `read_model`, or when there is no such file.
    """
    return significance_model(read_model(read_model_file(path), path or "the shipped model"))


def significance_model(model: TrainedModel) -> SignificanceModel:
    """Return what scores keypoints: boosted trees and logistic regression flattened, else scikit-learn itself."""
    several = model.estimator if isinstance(model.estimator, list) else [model.estimator]
    parts = [_log_odds(each, len(trait_names(model.groups))) for each in several]

    def score(traits: NDArray[np.float32]) -> FloatArray:
        odds: FloatArray = expit(sum(part(traits) for part in parts) / len(parts))
        return odds

    return SignificanceModel(model.groups, score)


def _log_odds(estimator: Any, n_features: int) -> Callable[[NDArray[np.float32]], FloatArray]:
    if isinstance(estimator, HistGradientBoostingClassifier):
        return tree_ensemble(estimator, n_features).log_odds
    if "logisticregression" in getattr(estimator, "named_steps", {}):
        return _line(estimator)

    def log_odds(traits: NDArray[np.float32]) -> FloatArray:
        odds: FloatArray = logit(probability(estimator, traits))
        return odds

    return log_odds


def _line(estimator: Any) -> Callable[[NDArray[np.float32]], FloatArray]:
    """Return filling, scaling and the linear model as one product."""
    filler, scaler, linear = estimator
    weights = linear.coef_[0] / scaler.scale_
    offset = float(linear.intercept_[0] - weights @ scaler.mean_)
    filling = filler.statistics_.astype(np.float32)

    def log_odds(traits: NDArray[np.float32]) -> FloatArray:
        odds: FloatArray = np.where(np.isnan(traits), filling, traits) @ weights + offset
        return odds

    return log_odds


def tree_ensemble(estimator: HistGradientBoostingClassifier, n_features: int) -> TreeEnsemble:
    """Return the trees of a binary gradient boosting classifier as flat arrays."""
    predictors = [stage[0].nodes for stage in estimator._predictors]
    sizes = [len(nodes) for nodes in predictors]
    roots = np.cumsum([0, *sizes[:-1]]).astype(np.int32)
    nodes = np.concatenate(predictors)
    first = np.repeat(roots, sizes)
    leaf = nodes["is_leaf"].astype(bool)
    return TreeEnsemble(
        feature=np.where(leaf, -1, nodes["feature_idx"]).astype(np.int32),
        threshold=nodes["num_threshold"].astype(np.float64),
        left=(nodes["left"] + first).astype(np.int32),
        right=(nodes["right"] + first).astype(np.int32),
        missing_left=nodes["missing_go_to_left"].astype(bool),
        value=nodes["value"].astype(np.float64),
        roots=roots,
        baseline=float(np.ravel(estimator._baseline_prediction)[0]),
        n_features=n_features,
    )
