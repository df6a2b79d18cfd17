"""The table of the second matching pass: it adds matches, and tells truthfully how many are right."""

from __future__ import annotations

from semscape.experiments.guided import guided_table
from semscape.experiments.study import Setting


def test_a_small_series_gains_matches_that_are_right() -> None:
    table = guided_table(Setting(quick=True, workers=1))
    (row,) = table.rows
    cells = dict(zip(table.columns, row, strict=True))
    assert cells["inliers added"] > 0.02 * cells["inliers"]
    assert 0.9 < cells["added right within 2 px"] <= 1
    assert 0.97 < cells["right within 2 px"] <= 1
    assert cells["tracks guided"] > cells["tracks"]
    assert 0 < cells["tilt error that images show (deg rms)"] < 0.1
    assert table.note.endswith("A quick run: one small series.")
