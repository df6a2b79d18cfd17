"""Which keypoints are worth matching: the classifiers' validation summary, what each trait buys, and the effect."""

from __future__ import annotations

from dataclasses import astuple, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from sklearn.metrics import precision_recall_curve, roc_auc_score, roc_curve

from semscape.experiments.significance_bound import BOUND_COLUMNS, bound_rows
from semscape.experiments.significance_effect import EFFECT_COLUMNS, SPEED_COLUMNS, effect_rows, speed_rows
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.features.traits import TRAITS
from semscape.io.series import load_series
from semscape.learning.classifiers import CLASSIFIERS
from semscape.learning.dataset import Dataset, capped, concatenate, label_group
from semscape.learning.run import SHIPPED_CLASSIFIER, SHIPPED_TRAITS
from semscape.learning.simulated_groups import N_GROUPS, SIZE_PX, simulated_group_with_truth
from semscape.learning.validate import PROTOCOLS, Scored, Summary, summarize, validate
from semscape.options import Options, RunOptions
from semscape.report.figures import ACCENT, INK, WARM, drawn_png
from semscape.types import SimulationTruth, TiltSeries

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

MEASURED = ("potamogeton1", "quartz", "dsa")
_THESIS_COUNTS = ("the thesis, 8 groups", 41, 167_241, None, None)
_ROWS = 3000
_QUICK = {"n_groups": 2, "size_px": 256, "rows": 300}
# One of the middle, and the two on which the classifiers do worst.
_EFFECT_ON_SIMULATED = ("fracture-0", "grating-0", "pollen-0")
# Each row of the ablation adds one group of traits to those above it; the descriptor alone is the thesis's.
_ABLATION = ("detector", "local", "margin", "density", "descriptor", "orientation", "distinctiveness")
_COLOURS = (ACCENT, WARM, INK, "#3f9c6b", "#8a5fbf", "#c2334d")


def run(setting: Setting) -> Experiment:
    """Build the training set, validate the classifiers, take the traits apart, measure the effect of keeping half."""
    options = replace(Options(), run=RunOptions(setting.seed))
    groups, notes = _groups(setting)
    parts = [label_group(name, series, options, seed=setting.seed, every_image=True) for name, series, _ in groups]
    drawn = [label_group(name, series, options, seed=setting.seed) for name, series, _ in groups]
    dataset = concatenate(parts)
    rows = _QUICK["rows"] if setting.quick else _ROWS
    specimens = sorted(set(dataset.specimen))
    scored = [
        result
        for protocol in PROTOCOLS
        for result in validate(
            dataset, tuple(CLASSIFIERS), SHIPPED_TRAITS, protocol=protocol, seed=setting.seed, rows_per_group=rows
        )
    ]
    summaries = [summarize(result) for result in scored]
    tested = [name for name in MEASURED if name in specimens] + [s for s in specimens if s not in MEASURED]
    shown = [group for group in groups if group[0] in (*MEASURED, *_EFFECT_ON_SIMULATED)]
    effects = effect_rows(dataset, shown, options, setting)
    speeds = speed_rows([(name, series) for name, series, _ in groups if name in MEASURED], options)
    return Experiment(
        name="significance",
        title="Significant keypoints",
        question=(
            "Can a classifier tell, before matching, which keypoints will find their partner, and what does it save to "
            "leave out the others? A keypoint is significant when it has a verified correspondence in another image of "
            "its group. Pooled folds leak, because the same point of the surface lies in both; a specimen "
            f"left out of training is the honest test. At most {rows} keypoints of each group are drawn."
        ),
        thesis="sections 2.4 and 3.7: 8 groups, 41 images, 167,241 keypoints; it chose the SVM on descriptors alone; "
        "its scores: not published here",
        tables=(
            _counts(dataset, concatenate(drawn)),
            _summary_table(summaries),
            _bound(dataset, {name: series.shape[1] for name, series, _ in groups}, scored, setting.seed, rows),
            _ablation(dataset, tested, setting.seed, rows),
            Table("effect", "Half of the keypoints, by model and by rivals, beside all", EFFECT_COLUMNS, effects),
            Table("speed", "What half of so many keypoints saves", SPEED_COLUMNS, speeds),
        ),
        figures=_curves(scored),
        notes=(
            *notes,
            "In the effect the model has never seen the specimen. Seconds are processor time of one thread; to load "
            "the model, half a second once per process, is not in them. Errors are against the truth of simulated "
            "series: of the tilts but for a common turn, rms, and of the heights of sparse points, robust sigma.",
        ),
    )


def _groups(setting: Setting) -> tuple[list[tuple[str, TiltSeries, SimulationTruth | None]], list[str]]:
    notes: list[str] = []
    groups: list[tuple[str, TiltSeries, SimulationTruth | None]] = []
    for name in MEASURED:
        folder = None if setting.data is None else setting.data / "tilt_series" / name
        if folder is None or not folder.is_dir():
            notes.append(f"the measured series {name} is left out: it was not given")
        elif not setting.quick:
            groups.append((name, load_series(folder, Options().input), None))
    for number in range(_QUICK["n_groups"] if setting.quick else N_GROUPS):
        groups.append(
            simulated_group_with_truth(
                number, setting.seed, size_px=_QUICK["size_px"] if setting.quick else SIZE_PX, workers=setting.workers
            )
        )
    return groups, notes


def _counts(every_image: Dataset, drawn: Dataset) -> Table:
    labelled = {row[0]: row[3:] for row in drawn.counts()}
    rows: list[tuple[Any, ...]] = [(*row[:3], *labelled[row[0]], *row[3:]) for row in every_image.counts()]
    totals = tuple(sum(row[column] for row in rows) for column in range(1, 7))
    return Table(
        name="counts",
        title="The training set beside the thesis's",
        columns=(
            "group", "images", "keypoints", "labelled, one image drawn", "significant, one image drawn",
            "labelled, every image", "significant, every image",
        ),
        rows=(*rows, ("all", *totals), (*_THESIS_COUNTS, None, None)),
        note=f"{len(rows)} groups.",
    )  # fmt: skip


def _summary_table(summaries: list[Summary]) -> Table:
    return Table(
        name="validation",
        title="Validation summary",
        columns=tuple(item.name for item in fields(Summary)),
        rows=tuple(astuple(row) for row in summaries),
        note="pooled leaks; unseen is the specimen left out. majority: accuracy of always saying the commoner class.",
    )


def _bound(dataset: Dataset, width_px: dict[str, int], scored: list[Scored], seed: int, rows: int) -> Table:
    shipped = [item for item in scored if (item.classifier, item.protocol) == (SHIPPED_CLASSIFIER, "unseen")]
    return Table(
        name="bound",
        title="What the specimen's own images would teach",
        columns=BOUND_COLUMNS,
        rows=bound_rows(dataset, width_px, shipped, seed=seed, rows_per_group=rows),
        note="The blend on unseen specimens, beside gradient boosting that learned from one half of the same images "
        "and is tried on the other, a tenth of the width between them, and the other way round. Better half: what "
        "share of an image's significant keypoints half of them keeps. Groups -0 are under the nominal microscope, -1 "
        "under the hard one.",
    )


def _ablation(dataset: Dataset, specimens: list[str], seed: int, rows: int) -> Table:
    chosen = capped(dataset, rows, rng=np.random.default_rng(seed))
    sets = [("sift",)] + [_ABLATION[: count + 1] for count in range(len(_ABLATION))] + [tuple(TRAITS)]
    table = []
    for groups in sets:
        results = validate(
            chosen, (SHIPPED_CLASSIFIER,), groups, protocol="unseen", seed=seed, rows_per_group=rows, left_out=specimens
        )
        name = "descriptor of the thesis" if groups == ("sift",) else f"+ {groups[-1]}"
        table.append((name, *(_auc(result) for result in results)))
    return Table(
        name="ablation",
        title="AUC on unseen specimens by the traits that the blend sees",
        columns=("traits", *specimens),
        rows=tuple(table),
        note="From the second row on each row adds a group of traits; the last adds the 128 numbers of the descriptor.",
    )


def _auc(scored: Scored) -> float:
    return float(roc_auc_score(scored.significant, scored.probability))


def _curves(scored: list[Scored]) -> tuple[Figure, Figure]:
    """Draw ROC and precision-recall curves, all keypoints of a protocol taken together."""

    def figure_of(kind: str, title: str, labels: tuple[str, str]) -> Figure:
        def draw(figure: Drawing) -> None:
            for axes, protocol in zip(figure.subplots(1, 2, sharey=True), PROTOCOLS, strict=True):
                for name, colour in zip(CLASSIFIERS, _COLOURS, strict=True):
                    chosen = [item for item in scored if (item.classifier, item.protocol) == (name, protocol)]
                    truth = np.concatenate([item.significant for item in chosen])
                    given = np.concatenate([item.probability for item in chosen])
                    if kind == "roc":
                        x, y, _ = roc_curve(truth, given)
                    else:
                        y, x, _ = precision_recall_curve(truth, given)
                    axes.plot(x, y, color=colour, label=name.replace("_", " "), linewidth=1.2)
                axes.set_title({"pooled": "pooled folds (leak)", "unseen": "unseen specimens"}[protocol], fontsize=9)
                axes.set_xlabel(labels[0])
                axes.grid(color=INK, alpha=0.2, linewidth=0.5)
            figure.axes[0].set_ylabel(labels[1])
            figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(_COLOURS))

        png = drawn_png((8.0, 4.0), draw, dpi=100)
        return Figure(kind, title, png, f"{title} of six classifiers, pooled folds beside unseen specimens.")

    return (
        figure_of("roc", "ROC curves", ("false positive rate", "true positive rate")),
        figure_of("precision_recall", "Precision-recall curves", ("recall", "precision")),
    )
