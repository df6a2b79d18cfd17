"""`semscape batch` from the command line: what is run, what is kept, what is told."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from run_products import QUICK, products, undrawn
from semscape.batch import folder_run
from semscape.batch import specimen as specimen_module
from semscape.cli import app
from semscape.io.lock import FolderLock
from semscape.report import figures


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the folders that are really reconstructed."""
    names: list[str] = []
    really = specimen_module.reconstruct_folder

    def noted(folder: Path, *given: Any, **named: Any) -> Any:
        names.append(folder.name)
        return really(folder, *given, **named)

    monkeypatch.setattr(specimen_module, "reconstruct_folder", noted)
    return names


def batch(manifest: Path, output: Path, *arguments: str) -> Any:
    options = output.parent / "options.toml"
    options.write_text(QUICK.to_toml())
    given = ["batch", str(manifest), "-o", str(output), "--options", str(options), "--workers", "0", *arguments]
    return CliRunner().invoke(app, given)


def rows(output: Path) -> dict[str, dict[str, str]]:
    with (output / "summary.csv").open(newline="", encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def test_a_batch_from_start_to_end(specimens: Path, tmp_path: Path, undisturbed, ran: list[str], monkeypatch) -> None:
    output = tmp_path / "out"
    done = batch(specimens, output)
    assert done.exit_code == 1, done.output
    assert "2 done, 0 kept from before, 1 failed" in done.output
    assert "failed: third: " in done.output
    assert "kB sent per specimen" in done.output
    told = rows(output)
    assert [row["state"] for row in told.values()] == ["done", "done", "failed"]
    assert told["third"]["exit_code"] == "2"
    assert "not an image that can be read" in told["third"]["reason"]
    assert told["first"]["verdict"].startswith(("good", "usable"))
    report = json.loads((output / "first" / "report.json").read_text(encoding="utf-8"))
    assert float(told["first"]["rms_px"]) == pytest.approx(report["metrics"]["rms_px"])
    assert float(told["first"]["peak_memory_mb"]) > 50
    assert products(output / "first") == undisturbed
    assert len((output / "first" / "run.log").read_text(encoding="utf-8").splitlines()) > 10
    page = (output / "summary.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2
    assert '<a href="first/report.html">first</a>' in page
    assert "<b>third</b>: " in page
    assert [stage["peak_memory_mb"] > 50 for stage in report["stages"]] == [True] * 5

    monkeypatch.setattr(figures, "drawn_png", undrawn)
    # Again: what is done and what failed is kept.
    ran.clear()
    again = batch(specimens, output)
    assert again.exit_code == 1
    assert ran == []
    assert "0 done, 2 kept from before, 1 failed" in again.output
    assert {row["kept"] for row in rows(output).values()} == {"yes"}

    # The failed ones when asked, and with better images.
    assert batch(specimens, output, "--retry-failed").exit_code == 1
    assert ran == ["third"]
    ran.clear()
    shutil.rmtree(specimens / "third")
    shutil.copytree(specimens / "first", specimens / "third")
    assert batch(specimens, output).exit_code == 0
    assert ran == ["third"]

    # Files that were only touched, and a result that is gone or damaged.
    ran.clear()
    next((specimens / "first").glob("*.tif")).touch()
    (output / "second" / "mesh.ply").unlink()
    assert batch(specimens, output).exit_code == 0
    assert ran == ["second"]
    ran.clear()
    damaged = output / "first" / "height_map.npz"
    content = bytearray(damaged.read_bytes())
    content[200] ^= 1
    damaged.write_bytes(content)
    assert batch(specimens, output).exit_code == 0
    assert ran == []
    assert batch(specimens, output, "--verify").exit_code == 0
    assert ran == ["first"]
    assert products(output / "first") == undisturbed

    # Other options, other code.
    ran.clear()
    assert batch(specimens, output, "--set", "run.seed=3").exit_code == 0
    assert ran == ["first", "second", "third"]


def test_other_code_runs_again(specimens: Path, tmp_path: Path, ran: list[str], monkeypatch) -> None:
    monkeypatch.setattr(
        specimen_module, "reconstruct_folder", lambda folder, *_, **__: ran.append(folder.name) or 1 / 0
    )
    assert batch(specimens, tmp_path / "out").exit_code == 1
    assert batch(specimens, tmp_path / "out").exit_code == 1
    assert ran == ["first", "second", "third"]
    assert "unexpected ZeroDivisionError" in rows(tmp_path / "out")["first"]["reason"]
    monkeypatch.setattr(specimen_module, "code_digest", lambda: "other")
    assert batch(specimens, tmp_path / "out").exit_code == 1
    assert ran == ["first", "second", "third"] * 2


def test_a_record_of_a_newer_semscape_is_not_overwritten(specimens: Path, tmp_path: Path) -> None:
    shutil.rmtree(specimens / "first")
    shutil.rmtree(specimens / "second")
    record = tmp_path / "out" / "records" / "third.json"
    record.parent.mkdir(parents=True)
    record.write_text('{"format": 99}')
    batch(specimens, tmp_path / "out")
    assert "written by a newer semscape" in rows(tmp_path / "out")["third"]["reason"]
    assert record.read_text() == '{"format": 99}'


@pytest.mark.parametrize("cause", ["locked", "newer", "foreign", "changed", "removed", "memory", "thread"])
def test_failures_that_pass_are_tried_again_unasked(
    specimens: Path, tmp_path: Path, ran: list[str], monkeypatch, cause: str
) -> None:
    shutil.rmtree(specimens / "second")
    shutil.rmtree(specimens / "third")
    output, image = tmp_path / "out", sorted((specimens / "first").glob("*.tif"))[0]
    run, content = output / "first", image.read_bytes()
    really = folder_run.reconstruct
    lock = FolderLock(run)

    def disturbed(*given: Any, **named: Any) -> Any:
        if cause == "changed":
            image.write_bytes(content + b"more")
        elif cause == "removed":
            image.unlink()
        elif cause == "memory":
            raise MemoryError
        elif cause == "thread":
            raise RuntimeError("can't start new thread")
        return really(*given, **named)

    monkeypatch.setattr(figures, "drawn_png", undrawn)
    run.mkdir(parents=True)
    if cause == "locked":
        lock.__enter__()
    elif cause == "newer":
        (run / "report.json").write_text('{"format": 99}')
        (run / "reconstruction.json").touch()
        (run / "options.toml").touch()
    elif cause == "foreign":
        (run / "letter.doc").touch()
    else:
        monkeypatch.setattr(folder_run, "reconstruct", disturbed)
    assert batch(specimens, output).exit_code == 1
    reason = rows(output)["first"]["reason"]
    expected = {"locked": "another process works on", "newer": "by a newer semscape", "foreign": "'letter.doc'"}
    expected |= {"changed": "changed while", "removed": "vanished while"}
    assert expected.get(cause, "out of memory in stage load") in reason

    monkeypatch.setattr(folder_run, "reconstruct", really)
    image.write_bytes(content)
    if cause == "locked":
        lock.__exit__()
    elif run.exists():
        shutil.rmtree(run)
    ran.clear()
    assert batch(specimens, output).exit_code == 0
    assert ran == ["first"]


def test_a_file_that_is_still_being_copied_is_no_answer(specimens: Path, tmp_path: Path, ran, monkeypatch) -> None:
    """It is damaged when it is read, and as it was when the digest was taken when the batch is started again."""
    shutil.rmtree(specimens / "second")
    shutil.rmtree(specimens / "third")
    image = sorted((specimens / "first").glob("*.tif"))[0]
    content = image.read_bytes()
    really = folder_run.load_series

    def while_it_is_copied(*given: Any) -> Any:
        image.write_bytes(content[: len(content) // 2])
        return really(*given)

    monkeypatch.setattr(folder_run, "load_series", while_it_is_copied)
    monkeypatch.setattr(figures, "drawn_png", undrawn)
    assert batch(specimens, tmp_path / "out").exit_code == 1
    assert "truncated" in rows(tmp_path / "out")["first"]["reason"]
    image.write_bytes(content)
    monkeypatch.setattr(folder_run, "load_series", really)
    ran.clear()
    assert batch(specimens, tmp_path / "out").exit_code == 0
    assert ran == ["first"]


def test_spread_over_workers_the_bytes_are_told(specimens: Path, tmp_path: Path, undisturbed) -> None:
    shutil.rmtree(specimens / "second")
    shutil.rmtree(specimens / "third")
    (tmp_path / "options.toml").write_text(QUICK.to_toml())
    given = ["batch", str(specimens), "-o", str(tmp_path / "out"), "--workers", "2", "--spread"]
    done = CliRunner().invoke(app, [*given, "--options", str(tmp_path / "options.toml")])
    assert done.exit_code == 0, done.output
    n_bytes = int(rows(tmp_path / "out")["first"]["bytes_sent"])
    assert n_bytes > 3 * 128 * 128 * 4  # the views travel, and what is found in them
    assert f"{n_bytes / 1e3:.1f} kB sent per specimen" in done.output
    assert products(tmp_path / "out" / "first") == undisturbed


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        ("folder,tilt\na,1\n", [], "the nearest one is 'tilts'"),
        ("folder,seed\na,-1\n", [], "line 2: seed must be a whole number"),
        ("folder\na\n", ["--scheduler", "tcp://127.0.0.1:1"], "--workers is for this machine"),
        ("folder\na\n", ["--set", "dense.pairs=1"], "the nearest one is 'max_pairs'"),
    ],
)
def test_wrong_usage_ends_with_2_before_anything_runs(tmp_path: Path, text: str, arguments: list[str], message) -> None:
    (tmp_path / "m.csv").write_text(text)
    done = batch(tmp_path / "m.csv", tmp_path / "out", *arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert not (tmp_path / "out" / "summary.csv").exists()


def test_cells_are_no_formulas(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("folder,name\n=1+1,=cmd\n")
    assert batch(tmp_path / "m.csv", tmp_path / "out").exit_code == 1
    assert "'=cmd" in rows(tmp_path / "out")
