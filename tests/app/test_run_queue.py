"""The queue and what it keeps on disk, without a server."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from held_jobs import Jobs

from app_server import app_environment
from semscape.app.desk import Desk
from semscape.app.run_queue import RunQueue
from semscape.app.run_state import RunState, read_state, write_state
from semscape.app.told import Change, History
from semscape.app.workspace import BusyRunError, Workspace
from semscape.errors import BadInputError


def add(workspace: Workspace, title: str, images: Path) -> str:
    name = workspace.create(title).name
    for path in sorted(images.glob("*.tif"))[:2]:
        shutil.copy(path, workspace.folder / "images" / name)
    return name


def wait_until(workspace: Workspace, name: str, state: str) -> None:
    until = time.monotonic() + 30
    while workspace.run(name).state.state != state:
        assert time.monotonic() < until, workspace.run(name).state
        time.sleep(0.02)


def test_the_queue_outlives_the_app(workspace: Workspace, master_images: Path, jobs: Jobs) -> None:
    names = [add(workspace, title, master_images) for title in ("b", "a", "c")]
    with RunQueue(workspace, jobs) as queue:
        for name in names:
            queue.submit(name)
        wait_until(workspace, names[0], "running")
        assert queue.waiting() == names[1:]
    assert jobs.job(0).stopped
    assert workspace.run(names[0]).state.state == "running"  # as after a kill -9
    again = Jobs(jobs._result)
    again.free = True
    with RunQueue(Workspace(workspace.folder), again):
        for name in names:
            wait_until(workspace, name, "done")
    assert [job.run.name for job in again.started] == names


def test_two_runs_at_once_where_that_is_asked_for(workspace: Workspace, master_images: Path, jobs: Jobs) -> None:
    names = [add(workspace, title, master_images) for title in ("a", "b", "c")]
    with RunQueue(workspace, jobs, at_once=2) as queue:
        for name in names:
            queue.submit(name)
        wait_until(workspace, "a", "running")
        wait_until(workspace, "b", "running")
        time.sleep(0.1)
        assert workspace.run("c").state.state == "queued"
        jobs.job(1).go.set()
        wait_until(workspace, "c", "running")


def test_a_run_asked_for_again_waits_for_its_own_end(workspace: Workspace, master_images: Path, jobs: Jobs) -> None:
    name = add(workspace, "a", master_images)
    with RunQueue(workspace, jobs) as queue:
        queue.submit(name)
        wait_until(workspace, name, "running")
        with pytest.raises(BusyRunError, match="already"):
            queue.submit(name)
        queue.cancel(name)
        with pytest.raises(BusyRunError, match="nothing to cancel"):
            queue.cancel(name)
        queue.submit(name)
        wait_until(workspace, name, "running")
        jobs.job(1).go.set()
        wait_until(workspace, name, "done")
    assert len(jobs.started) == 2


def test_a_job_that_does_not_start_stops_no_other(workspace: Workspace, master_images: Path, jobs: Jobs) -> None:
    first, second = add(workspace, "a", master_images), add(workspace, "b", master_images)
    jobs.free = True

    def start(run):  # type: ignore[no-untyped-def]
        if run.name == first:
            raise OSError("no more processes")
        return jobs(run)

    with RunQueue(workspace, start) as queue:
        queue.submit(first)
        queue.submit(second)
        wait_until(workspace, second, "done")
    assert "no more processes" in workspace.run(first).state.message


def test_a_run_needs_two_images_of_its_own(workspace: Workspace, master_images: Path, jobs: Jobs) -> None:
    name = workspace.create("empty").name
    with RunQueue(workspace, jobs) as queue, pytest.raises(BadInputError, match=r"0 image.*at least two"):
        queue.submit(name)


def test_a_state_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    change = Change("a.tif", "tilt_deg", None, -3.5)
    state = RunState(
        title="Pöllen",
        state="failed",
        originals={"a.tif": "ä.tif"},
        history=History((change,), (change,)),
        settings=("dense.max_pairs=2",),
        ticket=7,
        message="no",
        edited=True,
    )
    write_state(tmp_path, state)
    assert read_state(tmp_path) == state


def test_a_state_of_a_newer_semscape_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / ".semscape-app.json").write_text('{"format": 2}')
    with pytest.raises(BadInputError, match="update semscape"):
        read_state(tmp_path)


def test_a_process_that_dies_is_replaced() -> None:
    with Desk(1) as desk:
        for _ in range(2):
            with pytest.raises(BadInputError, match="no such folder"):
                desk.do("describe_images", Path("no-such-folder"))
            process = desk._workers[0]._process
            assert process is not None
            process.kill()
            process.wait(10)


def test_the_server_itself_loads_nothing_heavy() -> None:
    code = (
        "import sys, semscape.app.server; print(*{'numba', 'cv2', 'scipy', 'trimesh', 'matplotlib'} & set(sys.modules))"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], env=app_environment(), capture_output=True, text=True, check=True
    )
    assert loaded.stdout.strip() == ""
