"""The experiment of the significant keypoints, small."""

from __future__ import annotations

from semscape.experiments.significance import run
from semscape.experiments.study import Setting


def test_a_quick_run_has_all_tables_and_half_the_keypoints() -> None:
    done = run(Setting(quick=True, workers=2))
    tables = {table.name: table for table in done.tables}
    assert list(tables) == ["counts", "validation", "bound", "ablation", "effect", "speed"]
    # Six classifiers, pooled once and with each of the two specimens left out.
    assert len(tables["validation"].rows) == 6 * (1 + 2)
    assert {row[1] for row in tables["validation"].rows} == {"pooled", "unseen"}
    unseen = {row[2]: row[9] for row in tables["validation"].rows if row[:2] == ("blend", "unseen")}
    assert {row[0]: row[1] for row in tables["bound"].rows} == unseen
    for row in tables["bound"].rows:
        assert all(0.5 < figure <= 1 for figure in row[1:])
    everything, model, _, response, _, chance = tables["effect"].rows
    keypoints, inliers = 2, 6
    assert abs(model[keypoints] - everything[keypoints] / 2) < 1
    assert everything[inliers] == 1
    assert model[inliers] > chance[inliers]
    assert response[1] == "response"
    # Against the truth: a few tenths of a degree, a fraction of the relief.
    for row in (everything, model):
        tilt_deg, height_um = row[-2:]
        assert 0 < tilt_deg < 2
        assert 0 < height_um < 2
    assert all(figure.png.startswith(b"\x89PNG") for figure in done.figures)
    assert len(done.notes) >= 3
