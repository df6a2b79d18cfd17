"""What `semscape dataset`, `train` and `validate` do, from folders and files to files and rows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from semscape.errors import BadInputError
from semscape.features.traits import TRAITS, trait_names
from semscape.io.learning_files import read_arrays, write_arrays
from semscape.io.run_folder import put_files
from semscape.io.series import load_series
from semscape.learning.classifiers import CLASSIFIERS, fitted
from semscape.learning.dataset import ARRAYS, Dataset, capped, concatenate, dataset_of_arrays, label_group
from semscape.learning.model_store import TrainedModel, model_bytes
from semscape.learning.simulated_groups import simulated_dataset_parts
from semscape.learning.validate import PROTOCOLS, Summary, summarize, validate
from semscape.options import Options

SHIPPED_TRAITS = ("detector", "margin", "local", "density", "descriptor")
SHIPPED_CLASSIFIER = "blend"
ROWS_PER_GROUP = 20_000
ROWS_TO_VALIDATE = 4_000
Progress = Callable[[str], None]


def make_dataset(
    folders: Sequence[Path],
    output: Path,
    options: Options,
    *,
    every_image: bool = False,
    n_simulated: int = 0,
    workers: int | None = None,
    progress: Progress = lambda _: None,
) -> Dataset:
    """Label groups of images, those in folders and simulated ones, and write them to a file.

    Raises
    ------
    BadInputError
        Without any group, for two groups of one name, or for a group in which nothing matches.
    """
    names = [folder.resolve().name for folder in folders]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BadInputError(f"two groups are called {twice[0]}; rename one of the folders")
    parts = []
    for name, folder in zip(names, folders, strict=True):
        progress(name)
        series = load_series(folder, options.input)
        parts.append(label_group(name, series, options, seed=options.run.seed, every_image=every_image))
    simulated = simulated_dataset_parts(
        options.run.seed, options, n_groups=n_simulated, every_image=every_image, workers=workers
    )
    for part in simulated:
        progress(part.groups[0])
        parts.append(part)
    if not parts:
        raise BadInputError("no groups: give folders of images, or --simulated N")
    dataset = concatenate(parts)
    write_arrays(output, dataset.arrays())
    return dataset


def read_datasets(paths: Sequence[Path]) -> Dataset:
    """Return one dataset of all the files' groups."""
    return concatenate([dataset_of_arrays(read_arrays(path, ARRAYS), str(path)) for path in paths])


def train_model(
    dataset: Dataset,
    *,
    classifier: str = SHIPPED_CLASSIFIER,
    traits: Sequence[str] = SHIPPED_TRAITS,
    seed: int = 0,
    rows_per_group: int = ROWS_PER_GROUP,
) -> TrainedModel:
    """Train a classifier on a dataset.

    Raises
    ------
    BadInputError
        For a classifier or a group of traits that is not known, or a dataset of one class alone.
    """
    require_known([classifier], traits)
    if dataset.significant.all() or not dataset.significant.any():
        raise BadInputError("the dataset holds one class alone; there is nothing to tell apart")
    chosen = capped(dataset, rows_per_group, rng=np.random.default_rng(seed))
    features, names = chosen.columns(traits), trait_names(traits)
    estimator = fitted(classifier, features, chosen.significant, names=names, group=chosen.group, seed=seed)
    origin = {
        "groups": list(dataset.groups),
        "keypoints": len(chosen),
        "significant": int(chosen.significant.sum()),
        "classifier": classifier,
        "seed": seed,
        "data_sha256": hashlib.sha256(chosen.features.tobytes()).hexdigest(),
    }
    return TrainedModel(estimator, tuple(traits), origin)


def write_model(model: TrainedModel, path: Path) -> int:
    """Write a model's file and return its size in bytes."""
    content = model_bytes(model)
    put_files({path.name: content}, path.parent)
    return len(content)


def validation_rows(
    dataset: Dataset,
    *,
    classifiers: Sequence[str] = tuple(CLASSIFIERS),
    traits: Sequence[str] = SHIPPED_TRAITS,
    protocols: Sequence[str] = PROTOCOLS,
    seed: int = 0,
    rows_per_group: int = ROWS_TO_VALIDATE,
) -> list[Summary]:
    """Return the validation summary of some classifiers under some protocols."""
    require_known(classifiers, traits)
    specimens = set(dataset.specimen)
    if "unseen" in protocols and len(specimens) < 2:
        raise BadInputError(
            f"the dataset holds one specimen alone, {', '.join(specimens)}; to leave it out, add a dataset of another "
            "one: the specimen is the folder's name up to the first '-'"
        )
    return [
        summarize(scored)
        for protocol in protocols
        for scored in validate(
            dataset, classifiers, traits, protocol=protocol, seed=seed, rows_per_group=rows_per_group
        )
    ]


def require_known(classifiers: Sequence[str], traits: Sequence[str]) -> None:
    """Raise `BadInputError` for a name that is not known."""
    for name, known, what in (
        *((name, tuple(CLASSIFIERS), "classifier") for name in classifiers),
        *((name, tuple(TRAITS), "group of traits") for name in traits),
    ):
        if name not in known:
            raise BadInputError(f"there is no {what} {name!r}; there are: {', '.join(known)}")


def counts_text(dataset: Dataset) -> str:
    """Return the table of counts per group as lines of text."""
    rows: list[tuple[Any, ...]] = [("group", "images", "keypoints", "labelled", "significant"), *dataset.counts()]
    rows.append(("all", *(sum(row[column] for row in rows[1:]) for column in range(1, 5))))
    return "".join(f"{row[0]:<24}" + "".join(f"{value:>13}" for value in row[1:]) + "\n" for row in rows)


def validation_text(rows: Sequence[Summary]) -> str:
    """Return the validation summary as lines of text."""
    head = ("classifier", "protocol", "specimen", "majority", "accuracy", "precision", "recall", "f1", "auc")
    lines = ["".join(f"{name:<14}" for name in (*head, "tp", "fp", "fn", "tn", "train_s", "score_us"))]
    for row in rows:
        shares = (row.majority, row.accuracy, row.precision, row.recall, row.f1, row.auc)
        cells = [row.classifier, row.protocol, row.specimen, *(f"{value:.3f}" for value in shares)]
        counts = (row.true_positive, row.false_positive, row.false_negative, row.true_negative)
        times = (f"{row.train_s:.2f}", f"{row.score_us_per_keypoint:.2f}")
        lines.append("".join(f"{cell:<14}" for cell in (*cells, *counts, *times)))
    lines.append(
        "pooled leaks: the same point of the surface, in another image, is among those learned from; believe unseen, "
        "the specimen left out. majority: accuracy of always saying the commoner class; score_us: per keypoint."
    )
    return "\n".join(line.rstrip() for line in lines) + "\n"
