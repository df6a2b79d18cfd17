"""The training set and the validation: the label rule, the file, the two protocols, the commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from semscape.cli import app
from semscape.errors import BadInputError
from semscape.learning.dataset import Dataset, capped, concatenate, label_group
from semscape.learning.model_store import load_significance_model
from semscape.learning.run import read_datasets, train_model
from semscape.learning.simulated_groups import simulated_dataset_parts, simulated_group
from semscape.learning.validate import Scored, summarize, validate
from semscape.options import Options
from semscape.types import TiltSeries

SIZE = 192


@pytest.fixture(scope="module")
def groups() -> list[tuple[str, TiltSeries]]:
    return [simulated_group(number, 0, size_px=SIZE) for number in (0, 3)]


@pytest.fixture(scope="module")
def dataset(groups: list[tuple[str, TiltSeries]]) -> Dataset:
    return concatenate([label_group(*group, Options(), seed=0, every_image=True) for group in groups])


def test_one_image_is_drawn_and_its_labels_are_those_of_all_images(
    groups: list[tuple[str, TiltSeries]], dataset: Dataset
) -> None:
    name, series = groups[0]
    drawn = label_group(name, series, Options(), seed=0)
    assert len(np.unique(drawn.image)) == 1
    same = dataset.only(dataset.image == drawn.image[0])
    np.testing.assert_array_equal(same.xy, drawn.xy)
    np.testing.assert_array_equal(same.significant, drawn.significant)
    others = {int(label_group(name, series, Options(), seed=seed).image[0]) for seed in range(1, 6)}
    assert len(others | {int(drawn.image[0])}) > 1


def test_simulated_groups_follow_the_label_rule_too() -> None:
    whole, drawn = (
        next(simulated_dataset_parts(0, Options(), n_groups=1, every_image=every_image, size_px=SIZE))
        for every_image in (True, False)
    )
    assert len(np.unique(whole.image)) == 4
    assert len(np.unique(drawn.image)) == 1


def test_counts_name_every_image(dataset: Dataset) -> None:
    assert [row[0] for row in dataset.counts()] == ["fracture-0", "vickers-0"]
    for _, images, detected, labelled, significant in dataset.counts():
        assert (images, detected) == (4, labelled)
        assert 0 < significant < labelled
    assert dataset.specimen == ("fracture", "vickers")
    assert len(capped(dataset, 50, rng=np.random.default_rng(0))) == 100


def test_unseen_leaves_the_specimen_out(dataset: Dataset) -> None:
    # A trait that betrays the class in each specimen the other way round: pooled folds can use it, unseen cannot.
    betrayed = dataset.features.copy()
    betrayed[:, 0] = np.where(dataset.significant == (dataset.group == 0), 1.0, -1.0)
    betrayed[:, 1] = dataset.group
    rows = np.arange(len(dataset))
    tricked = Dataset(**{**vars(dataset.only(rows)), "features": betrayed})
    pooled, *_ = validate(tricked, ["boosting"], ["detector"], protocol="pooled", seed=0, rows_per_group=400)
    unseen = list(validate(tricked, ["boosting"], ["detector"], protocol="unseen", seed=0, rows_per_group=400))
    assert summarize(pooled).auc > 0.99
    assert [result.specimen for result in unseen] == ["fracture", "vickers"]
    assert all(summarize(result).auc < 0.01 for result in unseen)


def test_the_summary_of_known_counts() -> None:
    truth = np.array([True] * 4 + [False] * 6)
    given = np.array([0.9, 0.8, 0.7, 0.1, 0.6, 0.2, 0.2, 0.2, 0.2, 0.2])
    summary = summarize(Scored("svm", "pooled", "all", given, truth, 0.0, 1e-5))
    assert (summary.true_positive, summary.false_positive, summary.false_negative, summary.true_negative) == (
        3,
        1,
        1,
        5,
    )
    assert (summary.accuracy, summary.precision, summary.recall, summary.f1) == (0.8, 0.75, 0.75, 0.75)
    assert summary.majority == 0.6
    assert summary.auc == pytest.approx(18 / 24)
    assert summary.score_us_per_keypoint == pytest.approx(1.0)


def test_data_that_teach_nothing_are_named(dataset: Dataset, groups: list[tuple[str, TiltSeries]]) -> None:
    with pytest.raises(BadInputError, match="one class"):
        train_model(dataset.only(dataset.significant))
    with pytest.raises(BadInputError, match="boosting"):
        train_model(dataset, classifier="oracle")
    with pytest.raises(BadInputError, match="alone"):
        list(validate(dataset.only(dataset.group == 0), ["svm"], ["detector"], protocol="unseen", seed=0,
                      rows_per_group=99))  # fmt: skip
    with pytest.raises(BadInputError, match="1 image"):
        label_group("one", groups[0][1].select((0,), "alone"), Options(), seed=0)


def label_first(dataset: Dataset) -> Dataset:
    """Return the first group alone."""
    n_images = sum(name.startswith(dataset.groups[0]) for name in dataset.images)
    rows = dataset.only(dataset.group == 0)
    return replace(rows, groups=rows.groups[:1], images=rows.images[:n_images], n_detected=rows.n_detected[:n_images])


def test_the_commands_from_images_to_a_validation(tmp_path: Path, dataset: Dataset) -> None:
    run = CliRunner().invoke
    made, model = tmp_path / "d.npz", tmp_path / "m.skops"
    from semscape.io.learning_files import write_arrays

    write_arrays(made, dataset.arrays())
    again = read_datasets([made])
    np.testing.assert_array_equal(again.features, dataset.features)
    assert again.counts() == dataset.counts()
    done = run(app, ["train", str(made), "-o", str(model), "--traits", "detector,margin", "--rows", "300"])
    assert done.exit_code == 0, done.output
    assert "600 keypoints" in done.output
    first = load_significance_model(str(model)).probability(dataset.columns(["detector", "margin"]))
    run(app, ["train", str(made), "-o", str(model), "--traits", "detector,margin", "--rows", "300"])
    again_scored = load_significance_model(str(model)).probability(dataset.columns(["detector", "margin"]))
    np.testing.assert_array_equal(again_scored, first)
    done = run(app, ["validate", str(made), "--classifier", "naive_bayes,logistic", "--rows", "200"])
    assert done.exit_code == 0, done.output
    head, *lines, note = done.output.splitlines()
    assert head.split()[-6:] == ["tp", "fp", "fn", "tn", "train_s", "score_us"]
    assert [len(line.split()) for line in lines] == [len(head.split())] * 2 * (1 + 2)
    assert note.startswith("pooled leaks")
    one, broken, text = tmp_path / "one.npz", tmp_path / "broken.npz", tmp_path / "text.npz"
    write_arrays(one, label_first(dataset).arrays())
    write_arrays(broken, dataset.arrays() | {"group": np.full(len(dataset), 2)})
    text.write_text("no archive")
    for wrong, message in (
        (["dataset", "-o", str(made)], "no groups"),
        (["validate", str(model)], "dataset"),
        (["validate", str(one)], "one specimen alone, fracture"),
        (["validate", str(broken)], "does not hang together"),
        (["train", str(text), "-o", str(model)], "no npz file of plain numbers"),
        (["train", str(tmp_path / "none.npz"), "-o", str(model)], "No such file"),
    ):
        failed = run(app, wrong)
        assert failed.exit_code == 2
        assert message in failed.output
