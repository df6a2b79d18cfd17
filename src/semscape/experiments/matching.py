"""A contrario RANSAC beside RANSAC with fixed thresholds: false alarms, precision and recall, measured pairs."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from statistics import fmean, median
from typing import Any

import numpy as np

from semscape.cluster import Mapper, local_mapper
from semscape.experiments.guided import guided_table
from semscape.experiments.matching_pairs import measured_pairs, simulated_pair
from semscape.experiments.study import Experiment, Setting, Table
from semscape.experiments.synthetic_matches import SHAPES, SyntheticPair, synthetic_pair, uniform_points
from semscape.robust.acransac import ac_ransac
from semscape.robust.models import AFFINE, FUNDAMENTAL, HOMOGRAPHY, Model
from semscape.robust.parallax import limit_parallax
from semscape.robust.ransac import ransac
from semscape.types import BoolArray

FIXED_THRESHOLDS_PX = (0.5, 1.0, 3.0)
_MODELS = {model.kind: model for model in (AFFINE, FUNDAMENTAL, HOMOGRAPHY)}
_N_MATCHES = 1000
_SIGMAS_PX = (0.1, 0.3, 1.0, 2.0, 3.0)
_OUTLIER_SHARES = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9)
_TRIALS = 10_000
_NOISE_TRIALS = 2000
_QUESTION = (
    "Does the a contrario criterion find inliers without a threshold, and nothing where there is nothing? Uniform "
    "matches ask for false alarms; synthetic pairs with known truth ask for precision and recall from clean to noisy "
    "and from few wrong matches to nine in ten; one setting must serve all. Plain RANSAC with a threshold of 0.5, 1 "
    "and 3 px differs in nothing but the threshold. Measured and simulated micrographs follow, without a ratio test."
)


def run(setting: Setting) -> Experiment:
    """Run the experiment; without `setting.data` the measured pairs are left out and a note says so."""
    with local_mapper(setting.workers) as mapper:
        noise = _false_alarms(setting, mapper)
        synthetic = _precision_and_recall(setting, mapper)
    simulated, figure = simulated_pair(setting, FIXED_THRESHOLDS_PX)
    measured, notes = measured_pairs(setting)
    quick = ("A quick run: few repetitions, the figures are rough.",) if setting.quick else ()
    return Experiment(
        "matching",
        "Inliers without a threshold",
        _QUESTION,
        "section 2.3, figure 2.3 (TEM grid: 3119 inliers a contrario, 2207 with a fixed threshold)",
        (noise, *synthetic, simulated, *measured, guided_table(setting)),
        (figure,),
        (*quick, *notes, _conclusion(synthetic[0])),
    )


def _false_alarms(setting: Setting, mapper: Mapper) -> Table:
    sizes = (20, 100) if setting.quick else (20, 50, 100, 500, 1000, 5000)
    n_runs = 20 if setting.quick else 1000

    def least_nfa(case: tuple[Model, int, int]) -> float:
        model, n, number = case
        rng = np.random.default_rng([setting.seed, 1, n, number])
        x1, x2 = uniform_points(n, rng=rng), uniform_points(n, rng=rng)
        return ac_ransac(model, x1, x2, shapes=SHAPES, rng=rng, max_trials=_NOISE_TRIALS).log10_nfa

    rows = []
    for (kind, model), n in product(_MODELS.items(), sizes):
        # The other models are for comparison: a tenth of the runs, and not the longest.
        runs = n_runs if kind == "affine" else n_runs // 10
        if kind != "affine" and n > 1000:
            continue
        found = np.array(list(mapper(least_nfa, [(model, n, number) for number in range(runs)])))
        rows.append((kind, n, runs, float((found < 0).mean()), float((found < -2).mean()), float(found.min())))
    return Table(
        "false_alarms",
        "Matches thrown uniformly: how often is a model called meaningful?",
        ("model", "matches", "runs", "share NFA < 1", "share NFA < 0.01", "least log10 NFA"),
        tuple(rows),
        f"{_NOISE_TRIALS} trials a run, images of {SHAPES[0][1]} x {SHAPES[0][0]} px. By definition of the number of "
        "false alarms the shares are at most 1 and 0.01.",
    )


def _precision_and_recall(setting: Setting, mapper: Mapper) -> tuple[Table, Table]:
    n_runs = 5 if setting.quick else 100
    sigmas = (0.3, 3.0) if setting.quick else _SIGMAS_PX
    shares = (0.5, 0.8) if setting.quick else _OUTLIER_SHARES

    def one_run(case: tuple[float, float, int]) -> list[float]:
        sigma, share, number = case
        rng = np.random.default_rng([setting.seed, 2, round(1000 * sigma), round(1000 * share), number])
        pair = synthetic_pair(_N_MATCHES, share, sigma, rng=rng)
        common: dict[str, Any] = {"shapes": SHAPES, "rng": rng, "max_trials": _TRIALS}
        found = ac_ransac(AFFINE, pair.x1, pair.x2, **common)
        precision, recall = _judge(pair, found.inliers)
        figures = [precision, recall, pair.best_precision(recall), pair.best_precision(0.9), found.threshold_px]
        figures += _judge(pair, limit_parallax(found, pair.x1, pair.x2, SHAPES).inliers)
        for threshold in FIXED_THRESHOLDS_PX:
            fixed = ransac(AFFINE, pair.x1, pair.x2, threshold_px=threshold, **common)
            figures += _judge(pair, fixed.inliers)
        return figures

    rows, fixed_rows = [], []
    for sigma, share in product(sigmas, shares):
        runs = list(mapper(one_run, [(sigma, share, number) for number in range(n_runs)]))
        medians = [median(column) for column in zip(*runs, strict=True)]
        precision, recall, bound, bound_90, threshold, limited_precision, limited_recall, *fixed = medians
        ratio = threshold / sigma
        limited = limited_precision, limited_recall
        rows.append((sigma, share, precision, recall, bound, bound_90, threshold, ratio, *limited))
        fixed_rows.append((sigma, share, precision, recall, *fixed))
    note = f"Medians over {n_runs} pairs of {_N_MATCHES} matches, affine model, at most {_TRIALS} trials. "
    return (
        Table(
            "precision_recall",
            "Synthetic pairs, no threshold given",
            (
                "sigma (px)",
                "outliers",
                "precision",
                "recall",
                "best precision at this recall",
                "best precision at recall 0.90",
                "threshold (px)",
                "threshold / sigma",
                "precision, parallax limited",
                "recall, parallax limited",
            ),
            tuple(rows),
            note + "A wrong match near its epipolar line cannot be told from a right one by its distance to the line: "
            "the best precision is that of the true geometry with the threshold that has the recall. The last two "
            "columns bound the parallax along the line as well, a contrario too (semscape.robust.parallax).",
        ),
        Table(
            "fixed_thresholds",
            "The same pairs with fixed thresholds",
            (
                "sigma (px)",
                "outliers",
                "a contrario precision",
                "a contrario recall",
                *(f"{limit:g} px {figure}" for limit in FIXED_THRESHOLDS_PX for figure in ("precision", "recall")),
            ),
            tuple(fixed_rows),
            note,
        ),
    )


def _judge(pair: SyntheticPair, inliers: BoolArray) -> tuple[float, float]:
    return float(pair.right[inliers].mean()) if inliers.any() else 0.0, float(inliers[pair.right].mean())


def _conclusion(table: Table) -> str:
    rows = [row for row in table.rows if row[1] <= 0.8]
    ratio: Callable[[tuple[Any, ...]], float] = lambda row: row[7]  # noqa: E731
    below = [row for row in rows if row[2] < 0.97]
    return (
        f"Up to 80 % outliers the least recall is {min(row[3] for row in rows):.3f}, and the least precision "
        f"{min(row[2] for row in rows):.3f}; {len(below)} of {len(rows)} cases lie below 0.97, and there the true "
        f"geometry itself reaches {fmean([row[4] for row in below] or [1.0]):.3f} in the mean at the same recall. The "
        f"threshold is {min(map(ratio, rows)):.2f} to {max(map(ratio, rows)):.2f} times sigma. With the parallax "
        f"limited the least precision is {min(row[8] for row in rows):.3f} and the least recall "
        f"{min(row[9] for row in rows):.3f}."
    )
