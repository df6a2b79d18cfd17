"""The page of experiments in its four forms, and the registry."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from semscape.errors import BadInputError, NoAnswerError
from semscape.experiments import registry
from semscape.experiments.page import render_markdown, write_experiments
from semscape.experiments.registry import EXPERIMENTS, chosen_experiments, run_experiments
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.report.figures import drawn_png


def small(name: str = "matching", rows: int = 2) -> Experiment:
    table = Table(
        "inliers", "Inliers", ("pair", "fixed", "a contrario", "share"), (("a | b", 2207, 3119, None), ("c", 1, 2, 0.5))
    )
    many = Table("many", "Many", ("n", "square"), tuple((i, i * i) for i in range(rows)), "A note.")
    png = drawn_png((2.0, 1.0), lambda figure: figure.add_subplot().plot([0, 1]), dpi=50)
    figure = Figure("curve", "Curve", png, "A rising line.")
    return Experiment(
        name, "Matching", "How many? 5 +- 1.", "3119 against 2207", (table, many), (figure,), ("<left> out",)
    )


@pytest.fixture
def page(tmp_path: Path) -> Path:
    write_experiments([small(rows=200)], Setting(seed=7), tmp_path / "out")
    return tmp_path / "out"


def test_every_form_is_written(page: Path) -> None:
    names = {str(path.relative_to(page)) for path in page.rglob("*") if path.is_file()}
    assert names == {
        "experiments.html",
        "experiments.json",
        "experiments.md",
        "experiments/matching_curve.png",
        "experiments/matching_inliers.csv",
        "experiments/matching_many.csv",
    }


def test_json_holds_numbers_as_numbers(page: Path) -> None:
    told = json.loads((page / "experiments.json").read_text())
    assert (told["seed"], told["quick"]) == (7, False)
    (item,) = told["experiments"]
    assert item["thesis"] == "3119 against 2207"
    assert item["tables"][0]["rows"][0] == ["a | b", 2207, 3119, None]
    assert (page / item["figures"][0]["file"]).is_file()


def test_csv_leaves_unknown_cells_empty(page: Path) -> None:
    with (page / "experiments" / "matching_inliers.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[:2] == [["pair", "fixed", "a contrario", "share"], ["a | b", "2207", "3119", ""]]


def test_markdown_embeds_the_figures_by_a_path_that_is_there(page: Path) -> None:
    text = (page / "experiments.md").read_text()
    assert "![A rising line.](experiments/matching_curve.png)" in text
    assert "| a \\| b | 2,207 | 3,119 | – |" in text
    assert "[200 rows as CSV](experiments/matching_many.csv)" in text
    assert "seed 7" in text
    assert "quick" not in text


def test_html_asks_for_nothing_and_is_escaped(page: Path) -> None:
    text = (page / "experiments.html").read_text()
    assert "data:image/webp;base64," in text
    assert "http://" not in text
    assert "https://" not in text
    assert "&lt;left&gt; out" in text
    assert "5 ± 1" in text
    assert "<details><summary>200 rows</summary>" in text


def test_a_page_of_several_has_an_overview_with_the_thesis_figures() -> None:
    unpublished = Experiment("new", "New", "?", "", ())
    text = render_markdown([small(), unpublished], Setting(quick=True))
    assert "| Matching | 3119 against 2207 |" in text
    assert "| New | not published here |" in text
    assert "**In the thesis:** not published here" in text
    assert "quick run" in text
    assert "semscape experiments all" in text


def test_the_same_experiments_give_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_experiments([small()], Setting(), tmp_path / folder)
    files = [path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()]
    assert len(files) == 6
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "method.md").write_text("mine")
    write_experiments([small()], Setting(), tmp_path)
    assert (tmp_path / "method.md").read_text() == "mine"


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="file"):
        write_experiments([small()], Setting(), tmp_path / "file")


def test_an_unknown_name_names_the_nearest_one() -> None:
    with pytest.raises(BadInputError, match="no experiment 'face'; the nearest one is 'faces'"):
        chosen_experiments("face")
    assert chosen_experiments("all") == tuple(EXPERIMENTS)


def test_a_folder_of_data_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="nowhere does not exist"):
        run_experiments("faces", Setting(data=tmp_path / "nowhere"))


def test_every_experiment_of_the_registry_is_there() -> None:
    from importlib import import_module

    for name, target in EXPERIMENTS.items():
        module, function = target.split(":")
        assert callable(getattr(import_module(module), function)), name


def test_the_docs_tell_the_experiments_in_the_order_of_the_thesis_with_its_figures() -> None:
    page = json.loads((Path(__file__).parents[2] / "docs" / "experiments.json").read_text(encoding="utf-8"))
    told = {item["name"]: item["thesis"] for item in page["experiments"]}
    assert list(told) == list(EXPERIMENTS)
    last = [re.findall(r"\d\.\d", text)[-1] for text in told.values()]
    assert last == sorted(last)
    assert "3119 inliers a contrario, 2207 with a fixed threshold" in told.pop("matching")
    assert all(text.endswith("not published here") for text in told.values())


def test_among_all_a_failure_is_a_note_and_alone_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(setting: Setting) -> Experiment:
        raise NoAnswerError("3 matches, need 24")

    def works(setting: Setting) -> Experiment:
        return small()

    monkeypatch.setattr(registry, "import_module", lambda name: {"bad": Bad, "good": Good}[name])
    Bad.run, Good.run = staticmethod(fails), staticmethod(works)
    monkeypatch.setattr(registry, "EXPERIMENTS", {"faces": "bad:run", "matching": "good:run"})
    lines: list[str] = []
    failed, done = run_experiments("all", Setting(), progress=lines.append)
    assert failed.notes == ("failed: 3 matches, need 24",)
    assert done.name == "matching"
    assert lines == ["faces (1 of 2)", "faces failed: 3 matches, need 24", "matching (2 of 2)"]
    with pytest.raises(NoAnswerError):
        run_experiments("faces", Setting())


class Bad:
    """Stands for a module."""


class Good:
    """Stands for a module."""
