"""Scoring: the compiled trees against scikit-learn, the model's file, what is kept, and the whole run with half."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import OneHotEncoder
from skops.io import dumps

import semscape
from semscape.errors import BadInputError
from semscape.features.detect import detect
from semscape.features.significance import TreeEnsemble, best_rows, keep_significant
from semscape.features.traits import TRAITS, keypoint_traits, trait_names
from semscape.learning.classifiers import CLASSIFIERS, fitted, probability
from semscape.learning.model_store import (
    TrainedModel,
    load_significance_model,
    model_bytes,
    read_model,
    significance_model,
)
from semscape.options import FeaturesOptions, Options, read_toml
from semscape.simulate import SimulationOptions, simulate
from semscape.types import Micrograph

GROUPS = ("detector", "margin")
SMALL = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=256, height_px=256)


class Harmless:
    """A type that no model needs."""


@pytest.fixture(scope="module")
def rows() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(4000, 4)).astype(np.float32)
    features[::7, 2] = np.nan
    return features, features[:, 0] + 0.3 * rng.normal(size=4000) > np.nan_to_num(features[:, 2])


def trained(rows: tuple[np.ndarray, np.ndarray], name: str = "boosting") -> TrainedModel:
    estimator = fitted(name, *rows, names=trait_names(GROUPS), group=np.zeros(len(rows[1]), int), seed=0)
    return TrainedModel(estimator, GROUPS, {"seed": 0})


@pytest.fixture(scope="module")
def series() -> semscape.TiltSeries:
    return simulate("fracture", SMALL, rng=0)[0]


@pytest.mark.parametrize("name", CLASSIFIERS)
def test_a_model_scores_the_same_after_its_file(rows: tuple[np.ndarray, np.ndarray], name: str) -> None:
    model = trained(rows, name)
    again = significance_model(read_model(model_bytes(model), "m"))
    assert again.groups == GROUPS
    expected = probability(model.estimator, rows[0])
    # scikit-learn scales in float32, the flattened logistic regression in float64.
    np.testing.assert_allclose(
        again.probability(rows[0]), expected, atol=2e-6 if name in ("logistic", "blend") else 1e-12
    )
    assert expected[rows[1]].mean() > expected[~rows[1]].mean() + 0.2


@pytest.mark.parametrize("name", CLASSIFIERS)
def test_the_same_model_has_the_same_bytes_at_another_place_and_time(
    rows: tuple[np.ndarray, np.ndarray], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = model_bytes(trained(rows, name))
    monkeypatch.setattr("time.time", lambda: 1e9)
    second = trained(rows, name)
    assert model_bytes(second) == first
    assert model_bytes(replace(second, origin={"seed": 1})) != first


def test_the_blend_is_the_mean_of_a_line_and_of_trees_that_bend_one_way() -> None:
    # The class falls with the response where the trees must let it rise: they stay out of it, and the line does not.
    rng = np.random.default_rng(2)
    features = rng.normal(size=(4000, 4)).astype(np.float32)
    names = trait_names(GROUPS)
    against, free = names.index("log_response"), names.index("log_scale")
    significant = features[:, free] - features[:, against] + rng.normal(size=4000) > 0
    line, trees = blend = fitted("blend", features, significant, names=names, group=np.zeros(4000, int), seed=0)
    swept = np.zeros((50, 4), np.float32)
    swept[:, against] = np.linspace(-2, 2, 50)
    assert np.ptp(trees.decision_function(swept)) == pytest.approx(0)
    assert (np.diff(line.decision_function(swept)) < 0).all()
    mean = (line.decision_function(swept) + trees.decision_function(swept)) / 2
    np.testing.assert_allclose(probability(blend, swept), 1 / (1 + np.exp(-mean)), rtol=1e-6)
    upward = swept[:, [against, free, 2, 3]]
    assert np.ptp(trees.decision_function(upward)) > 1


def test_the_line_of_the_blend_lets_every_class_of_every_group_count_the_same() -> None:
    # One trait tells the groups apart and nothing else; in one of them nearly all are significant.
    rng = np.random.default_rng(3)
    group = np.repeat([0, 1], 2000)
    significant = rng.random(4000) < np.where(group == 0, 0.9, 0.1)
    features = np.column_stack([group, rng.normal(size=(4000, 3))]).astype(np.float32)
    line, _ = fitted("blend", features, significant, names=trait_names(GROUPS), group=group, seed=0)
    assert probability(line, features)[group == 0].mean() == pytest.approx(0.5, abs=0.02)
    taken_as_is = fitted("logistic", features, significant, names=trait_names(GROUPS), group=group, seed=0)
    assert probability(taken_as_is, features)[group == 0].mean() == pytest.approx(0.9, abs=0.02)


def test_a_file_with_another_type_is_not_opened(rows: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(BadInputError, match=r"Harmless.*not opened"):
        read_model(dumps({"format": "semscape-significance-1", "estimator": Harmless()}), "evil.skops")


@pytest.mark.parametrize("data", [b"", b"no archive", dumps({"format": "other"})])
def test_what_is_no_model_is_said_so(data: bytes) -> None:
    with pytest.raises(BadInputError, match=r"m\.skops"):
        read_model(data, "m.skops")


def content(estimator: object, groups: object = GROUPS) -> bytes:
    groups = list(groups) if isinstance(groups, tuple) else groups
    return dumps({"format": "semscape-significance-1", "groups": groups, "origin": {}, "estimator": estimator})


@pytest.mark.parametrize("groups", [None, 5, [], [5]])
def test_a_model_says_what_it_takes(groups: object) -> None:
    with pytest.raises(BadInputError, match="does not say"):
        read_model(content(LogisticRegression(), groups), "m.skops")


@pytest.mark.parametrize("estimator", [None, 3, [], [[]], LogisticRegression(), Pipeline([("a", OneHotEncoder())])])
def test_what_is_none_of_our_classifiers_is_refused(estimator: object) -> None:
    with pytest.raises(BadInputError, match="it is made of"):
        read_model(content(estimator), "m.skops")


def test_a_model_of_other_traits_than_it_says_is_refused(rows: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(BadInputError, match="cannot score"):
        read_model(content(trained(rows, "blend").estimator, ("detector",)), "m.skops")


def test_a_forest_that_walks_in_circles_is_refused(rows: tuple[np.ndarray, np.ndarray]) -> None:
    forest = trained(rows, "random_forest").estimator
    tree = forest[-1].estimators_[3].tree_
    state = tree.__getstate__()
    inner = int(np.flatnonzero(state["nodes"]["left_child"] > 0)[1])
    state["nodes"]["left_child"][inner] = 0
    tree.__setstate__(state)
    with pytest.raises(BadInputError, match="not sound"):
        read_model(content(forest), "m.skops")


def test_trees_that_might_never_end_are_refused() -> None:
    number = np.array([0, -1, -1], np.int32)
    sound = {"left": np.array([1, 0, 0], np.int32), "right": np.array([2, 0, 0], np.int32)}
    rest = {
        "threshold": np.zeros(3),
        "missing_left": np.zeros(3, bool),
        "value": np.array([0.0, -1.0, 1.0]),
        "roots": np.zeros(1, np.int32),
        "baseline": 0.0,
        "n_features": 1,
    }
    trees = TreeEnsemble(feature=number, **sound, **rest)
    low, high, missing = trees.log_odds(np.array([[-1.0], [1.0], [np.nan]], np.float32))
    assert (low, high) == (-1, 1)
    assert missing == high
    for broken in (sound | {"left": np.zeros(3, np.int32)}, sound | {"right": np.array([9, 0, 0], np.int32)}):
        with pytest.raises(ValueError, match="not sound"):
            TreeEnsemble(feature=number, **broken, **rest)
    with pytest.raises(ValueError, match="takes 1 traits"):
        trees.log_odds(np.zeros((2, 3), np.float32))


def test_best_rows_keeps_the_count_when_scores_are_equal() -> None:
    assert best_rows(np.ones(10), 0.5).tolist() == [0, 1, 2, 3, 4]
    rng = np.random.default_rng(1)
    score = rng.integers(0, 5, 101).astype(float)
    kept = best_rows(score, 0.37)
    assert len(kept) == 37
    assert score[kept].min() >= np.delete(score, kept).max()


def test_traits_ignore_the_brightness_and_contrast_of_the_file(series: semscape.TiltSeries) -> None:
    view = series.views[1]
    found = detect(view, FeaturesOptions())
    brighter = Micrograph(view.name, (3 * view.image + 50).astype(np.float32), view.mask, view.metadata)
    groups = [group for group in TRAITS if group != "orientation"]
    once, twice = keypoint_traits(view, found, groups), keypoint_traits(brighter, found, groups)
    assert once.shape == (len(found), len(trait_names(groups)))
    assert np.isfinite(once).all()
    np.testing.assert_allclose(once, twice, rtol=2e-2, atol=2e-2)


def test_orientation_is_unknown_where_the_axis_is() -> None:
    view = simulate("fracture", SMALL, rng=0)[0].views[0]
    found = detect(view, FeaturesOptions())
    assert np.isnan(keypoint_traits(view, found, ["orientation"])).all()
    told = replace(view, metadata=replace(view.metadata, tilt_axis_angle_rad=np.pi / 2))
    # Along the tilt axis, which is vertical: down the image.
    down = replace(found, orientation_rad=np.full(len(found), np.pi / 2))
    np.testing.assert_allclose(keypoint_traits(told, down, ["orientation"])[0], [1, 0], atol=1e-6)


def test_the_shipped_model_keeps_more_of_what_matches_than_chance(series: semscape.TiltSeries) -> None:
    half = semscape.reconstruct(series, Options().with_settings(["features.significance.keep=0.5"]), rng=0)
    whole = semscape.reconstruct(series, rng=0)
    detect_figures = half.report.stages[0].figures
    assert detect_figures["n_kept"] == pytest.approx(detect_figures["n_keypoints"] / 2, abs=2)
    assert detect_figures["n_keypoints"] == sum(len(found) for found in whole.keypoints)
    kept = sum(pair["inliers"] for pair in half.report.pairs) / sum(pair["inliers"] for pair in whole.report.pairs)
    assert 0.5 < kept < 1.1  # at random a quarter
    assert all(found.significance is not None for found in half.keypoints)


def test_each_image_is_scored_once_whatever_the_number_of_its_pairs(
    series: semscape.TiltSeries, monkeypatch: pytest.MonkeyPatch
) -> None:
    scored: list[str] = []

    def counted(view: Micrograph, *rest: Any, **options: Any) -> Any:
        scored.append(view.name)
        return keep_significant(view, *rest, **options)

    monkeypatch.setattr("semscape.pipeline.keep_significant", counted)
    half = Options().with_settings(["features.significance.keep=0.5"])
    result = semscape.reconstruct(series, half, rng=0)
    assert len(result.report.pairs) == 3
    assert sorted(scored) == sorted(series.names)


def test_the_cheap_rules_and_the_threshold(series: semscape.TiltSeries) -> None:
    view = series.views[0]
    found = detect(view, FeaturesOptions())
    strong = keep_significant(view, found, FeaturesOptions(significance_keep=0.25, significance_by="response"), None)
    assert strong.response.min() >= np.sort(found.response)[-len(strong)]
    sure = keep_significant(view, found, FeaturesOptions(significance_threshold=0.4), load_significance_model(""))
    assert 0 < len(sure) < len(found)
    assert sure.significance is not None
    assert sure.significance.min() >= 0.4


def test_the_model_knows_sift_alone(series: semscape.TiltSeries) -> None:
    options = FeaturesOptions(detector="orb", significance_keep=0.5)
    found = detect(series.views[0], options)
    with pytest.raises(BadInputError, match=r"significance\.by"):
        keep_significant(series.views[0], found, options, load_significance_model(""))


def test_dotted_keys_are_options() -> None:
    options = Options().with_settings(["features.significance.keep=0.5", "features.significance.by=scale"])
    assert (options.features.significance_keep, options.features.significance_by) == (0.5, "scale")
    assert read_toml(options.to_toml()).features == options.features
    with pytest.raises(BadInputError, match="significance_keep"):
        Options().with_settings(["features.significance.keep=0"])
    with pytest.raises(BadInputError, match="a probability of the model"):
        Options().with_settings(["features.significance.threshold=0.5", "features.significance.by=scale"])
    with pytest.raises(BadInputError, match="cannot be read"):
        load_significance_model("no/such/file.skops")
