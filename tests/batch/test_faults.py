"""What may go wrong while a specimen is being run, and the promise for each."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from run_products import PRODUCTS, QUICK, products, undrawn
from semscape import pipeline
from semscape.batch.folder_run import reconstruct_folder
from semscape.cluster.processes import worker_environment
from semscape.errors import BadInputError, OutOfMemoryError
from semscape.io.finished_run import read_finished_run
from semscape.io.lock import FolderLock
from semscape.io.process_status import status_mb
from semscape.io.run_folder import RUN_FILES, WORK_NAME
from semscape.report import figures

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and mounts of POSIX")


@pytest.fixture(autouse=True)
def no_drawings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "drawn_png", undrawn)


def run(images: Path, output: Path, progress: Callable[[str, Any], None] | None = None) -> None:
    reconstruct_folder(images, output, QUICK, workers=1, progress=progress)


def interrupted_before(images: Path, output: Path, stage: str) -> None:
    def stop(name: str, _: Any) -> None:
        if name == stage:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(images, output, stop)


def assert_complete(output: Path, expected: dict[str, bytes]) -> None:
    assert products(output) == expected
    assert sorted(path.name for path in output.iterdir()) == sorted([*RUN_FILES, "run.log"])


# kill -9


def test_killed_at_every_stage_and_at_random_moments_then_resumed(images: Path, tmp_path: Path, undisturbed) -> None:
    """After each kill the bytes are compared there; those of another process, which was never killed, here."""
    output = tmp_path / "run"
    script = Path(__file__).with_name("killed_runs.py")
    environment = worker_environment(threads=1) | {"NUMBA_THREADING_LAYER": "workqueue"}
    done = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", script, images, output],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    run(images, output)
    assert_complete(output, undisturbed)


def test_a_resumed_run_computes_no_finished_stage_again(images: Path, tmp_path: Path, undisturbed, caplog) -> None:
    output = tmp_path / "run"
    interrupted_before(images, output, "surface")
    assert sorted(path.stem for path in (output / WORK_NAME).glob("*.value")) == ["calibrate", "detect", "match"]
    run(images, output)
    assert_complete(output, undisturbed)
    told = (output / "run.log").read_text(encoding="utf-8")
    assert told.count("taken from the interrupted run") == 3


def test_a_resumed_run_reports_what_its_stages_took_when_they_were_made(
    images: Path, tmp_path: Path, monkeypatch
) -> None:
    really = pipeline._match_all
    resident_mb = []

    def slowly(*given: Any) -> Any:
        time.sleep(1.0)
        held = np.ones(600_000_000, np.uint8)
        resident_mb.append(status_mb("VmRSS"))  # not against another stage: what other tests left may go in between
        del held
        return really(*given)

    monkeypatch.setattr(pipeline, "_match_all", slowly)
    output = tmp_path / "run"
    interrupted_before(images, output, "surface")
    found = reconstruct_folder(images, output, QUICK, workers=1)
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    stages = {stage["name"]: stage for stage in report["stages"]}
    assert [name for name, stage in stages.items() if stage["earlier"]] == ["detect", "match", "calibrate"]
    assert stages["match"]["seconds"] > 1.0
    assert stages["match"]["peak_memory_mb"] >= 0.99 * resident_mb[0] > 600
    assert report["peak_memory_mb"] == max(stage["peak_memory_mb"] for stage in report["stages"])
    page = (output / "report.html").read_text(encoding="utf-8")
    assert '<th scope="row">match*</th>' in page
    assert "* done before this run was interrupted" in page
    assert sum(stage.seconds for stage in found.report.stages) > 1.0
    lines = [json.loads(line) for line in (output / "run.log").read_text(encoding="utf-8").splitlines()]
    assert [line["seconds"] > 1.0 for line in lines if line.get("stage") == "match" and "seconds" in line] == [True]


def test_stages_of_other_options_are_not_taken(images: Path, tmp_path: Path, undisturbed) -> None:
    options = QUICK.with_settings(["features.ratio=0.7", "run.seed=4"])
    with pytest.raises(KeyboardInterrupt):
        reconstruct_folder(images, tmp_path / "run", options, workers=1, progress=_stop_at("mesh"))
    run(images, tmp_path / "run")
    assert_complete(tmp_path / "run", undisturbed)


def _stop_at(stage: str) -> Callable[[str, Any], None]:
    def stop(name: str, _: Any) -> None:
        if name == stage:
            raise KeyboardInterrupt

    return stop


# Files that are damaged


@pytest.mark.parametrize("damage", ["bit", "cut", "empty", "other"])
def test_a_damaged_intermediate_file_is_noticed_and_made_again(images, tmp_path, undisturbed, damage: str) -> None:
    output = tmp_path / "run"
    interrupted_before(images, output, "surface")
    path = output / WORK_NAME / "match.value"
    content = bytearray(path.read_bytes())
    if damage == "bit":
        content[len(content) // 2] ^= 4
    path.write_bytes({"bit": content, "cut": content[:-7], "empty": b"", "other": b"PK\3\4" + content}[damage])
    run(images, output)
    assert_complete(output, undisturbed)
    assert "stage match is computed again" in (output / "run.log").read_text(encoding="utf-8")


def test_a_run_folder_of_a_newer_semscape_is_refused_politely(images: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    run(images, output)
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    report["format"] += 1
    (output / "report.json").write_text(json.dumps(report), encoding="utf-8")
    before = products(output)
    with pytest.raises(BadInputError, match=r"written by a newer semscape \(format 2; this one knows 1\): update"):
        run(images, output)
    with pytest.raises(BadInputError, match="written by a newer semscape"):
        read_finished_run(output)
    assert products(output) == before


# Inputs that change


@pytest.mark.parametrize("change", ["changed", "vanished", "appeared"])
def test_an_input_that_changes_meanwhile(images: Path, tmp_path: Path, undisturbed, change: str) -> None:
    output = tmp_path / "run"
    path = sorted(images.glob("*.tif"))[1]
    other = images / "view_99.tif"
    content = path.read_bytes()

    def disturb(stage: str, figures: Any) -> None:
        if stage == "calibrate" and figures is None:
            if change == "changed":
                path.write_bytes(content + b"\0")
            elif change == "vanished":
                path.unlink()
            else:
                other.write_bytes(content)

    with pytest.raises(BadInputError, match=f": {change} while") as refused:
        run(images, output, disturb)
    assert str(other if change == "appeared" else path) in str(refused.value)
    assert not list(output.iterdir())
    other.unlink(missing_ok=True)
    path.write_bytes(content)
    run(images, output)
    assert_complete(output, undisturbed)


# Disks


@contextlib.contextmanager
def small_disk(place: Path, options: str) -> Iterator[None]:
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", place], capture_output=True, check=False)
    if done.returncode:
        pytest.skip("mounting a file system is not allowed here")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", place], check=True)


@pytest.mark.parametrize("size", ["64k", "500k", "900k"])
def test_a_full_disk(images: Path, tmp_path: Path, undisturbed, size: str) -> None:
    disk = tmp_path / "disk"
    with small_disk(disk, f"size={size}"):
        with pytest.raises(BadInputError, match="cannot be written: No space left on device"):
            run(images, disk / "run")
        assert not (disk / "run" / "report.json").exists()
        subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
        run(images, disk / "run")
        assert_complete(disk / "run", undisturbed)


def test_a_quota(images: Path, tmp_path: Path, undisturbed) -> None:
    """Without rights to mount anything: no file may grow beyond 50 kB."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        with pytest.raises(BadInputError, match="cannot be written: File too large"):
            run(images, tmp_path / "run")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    run(images, tmp_path / "run")
    assert_complete(tmp_path / "run", undisturbed)


def test_a_read_only_output(images: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    with small_disk(disk, "ro"), pytest.raises(BadInputError, match="cannot be written: Read-only file system"):
        run(images, disk / "run")


# Two processes on one folder


def test_a_folder_in_use_is_refused(images: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with (
        FolderLock(tmp_path / "run"),
        pytest.raises(BadInputError, match=r"another process works on .*run; wait for it to end, or give another"),
    ):
        run(images, tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())


def test_a_lock_can_be_waited_for(tmp_path: Path) -> None:
    order = []
    with FolderLock(tmp_path):
        waiting = threading.Thread(target=lambda: [FolderLock(tmp_path, wait_s=20).__enter__(), order.append("second")])
        waiting.start()
        time.sleep(0.3)
        order.append("first")
    waiting.join()
    assert order == ["first", "second"]


def test_a_lock_survives_no_crash(tmp_path: Path) -> None:
    code = (
        "import os, sys, pathlib; from semscape.io.lock import FolderLock\n"
        "FolderLock(pathlib.Path(sys.argv[1])).__enter__(); print('held', flush=True); sys.stdin.read()"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        [sys.executable, "-c", code, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(BadInputError, match="another process"), FolderLock(tmp_path):
            pass
        process.kill()
    assert list(tmp_path.iterdir())  # the file is still there, and holds nobody up
    with FolderLock(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


# Signals


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_run_that_can_be_resumed(images: Path, tmp_path: Path, undisturbed, number, code: int) -> None:
    output = tmp_path / "run"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "semscape", "reconstruct", images, "-o", output, "--workers", "1"]
    command += ["--options", str(tmp_path / "options.toml")]
    (tmp_path / "options.toml").write_text(QUICK.to_toml())
    with subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        until = time.monotonic() + 60
        while not (output / WORK_NAME / "detect.value").exists() and time.monotonic() < until:
            time.sleep(0.01)
        process.send_signal(number)
        _, told = process.communicate(timeout=60)
    assert process.returncode == code, told
    assert "interrupted; what is finished is kept: run the same command again" in told
    assert "Traceback" not in told
    assert not set(PRODUCTS) & {path.name for path in output.iterdir()}
    run(images, output)
    assert_complete(output, undisturbed)


# Memory


@pytest.mark.parametrize(("stage", "advice"), [("detect", "features.max_keypoints"), ("surface", "dense.tile_px=512")])
def test_a_lack_of_memory_names_the_stage_and_what_to_reduce(images, tmp_path, stage: str, advice: str) -> None:
    def lack(name: str, _: Any) -> None:
        if name == stage:
            raise MemoryError

    with pytest.raises(OutOfMemoryError, match=rf"out of memory in stage {stage}; fewer --workers.*{advice}"):
        run(images, tmp_path / "run", lack)
