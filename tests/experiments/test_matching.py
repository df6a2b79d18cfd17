"""The tables of `experiments matching`, on its smallest run, hold what they say."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.experiments.matching import run
from semscape.experiments.study import Experiment, Setting
from semscape.experiments.synthetic_matches import synthetic_pair


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return run(Setting(seed=1, quick=True))


def column(experiment: Experiment, table: str, name: str) -> list:
    found = next(item for item in experiment.tables if item.name == table)
    return [row[found.columns.index(name)] for row in found.rows]


def test_noise_gives_no_alarm(experiment: Experiment) -> None:
    assert max(column(experiment, "false_alarms", "share NFA < 0.01")) == 0
    assert set(column(experiment, "false_alarms", "model")) == {"affine", "fundamental", "homography"}


def test_one_setting_serves_all(experiment: Experiment) -> None:
    recalls = column(experiment, "precision_recall", "recall")
    assert min(recalls) > 0.88
    ratios = column(experiment, "precision_recall", "threshold / sigma")
    assert max(ratios) < 1.6 * min(ratios)
    precision = np.array(column(experiment, "precision_recall", "precision"))
    best = np.array(column(experiment, "precision_recall", "best precision at this recall"))
    assert (precision < best + 0.03).all()  # nobody beats the truth but by luck
    assert (precision > best - 0.06).all()
    # No fixed threshold has both in all cases.
    for limit in ("0.5 px", "1 px", "3 px"):
        assert min(column(experiment, "fixed_thresholds", f"{limit} recall")) < 0.8


def test_the_simulated_pair_is_judged_and_drawn(experiment: Experiment) -> None:
    recall = column(experiment, "simulated_pair", "recall")
    precision = column(experiment, "simulated_pair", "precision")
    assert recall[-1] > recall[0] + 0.1
    assert min(precision) > 0.95
    (figure,) = experiment.figures
    assert figure.png.startswith(b"\x89PNG")


def test_what_is_left_out_is_told(experiment: Experiment) -> None:
    assert any("dsa, quartz" in note for note in experiment.notes)
    assert any("quick run" in note for note in experiment.notes)


def test_synthetic_matches_are_as_wrong_and_as_noisy_as_asked() -> None:
    pair = synthetic_pair(4000, 0.75, 0.7, rng=np.random.default_rng(0))
    assert (~pair.right).sum() == 3000
    # The larger of the two distances: for rows of both images each is |y1 - y2|, whose deviation is sqrt(2) sigma.
    assert np.sqrt((pair.true_residual_px()[pair.right] ** 2).mean()) == pytest.approx(0.7 * np.sqrt(2), rel=0.05)
    assert 0.98 < pair.best_precision(0.9) < 1
    assert pair.best_precision(0.5) > pair.best_precision(1.0)
