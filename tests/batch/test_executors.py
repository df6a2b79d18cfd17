"""Every executor gives the same results, and loses none when processes die."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from worker_tasks import add, complain, crash, die, die_once, fill, nothing, square, thread_limits

from run_products import QUICK, products
from semscape.batch.command import run_command
from semscape.batch.manifest import find_specimens
from semscape.batch.record import Ending
from semscape.batch.run import run_batch
from semscape.cluster import Counted, Placement, Serial, WorkerLostError, local_mapper, open_executor
from semscape.cluster.on_slurm import slurm_request
from semscape.cluster.processes import LocalProcesses, worker_environment
from semscape.errors import BadInputError, OutOfMemoryError
from semscape.io.run_folder import WORK_NAME
from semscape.io.series import load_series
from semscape.pipeline import reconstruct

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


class Silence:
    def event(self, name: str, stage: str) -> None:
        pass

    def ended(self, ending: Ending) -> None:
        pass


@pytest.mark.parametrize("placement", [Placement(workers=0), Placement(workers=2)], ids=["serial", "processes"])
def test_values_errors_and_order(placement: Placement) -> None:
    with open_executor(placement) as executor:
        assert list(executor.map(square, range(20))) == [x * x for x in range(20)]
        outcomes = sorted(executor.run(square, [2, -3, 4]), key=lambda outcome: outcome.index)
        assert [outcome.value for outcome in outcomes] == [4, None, 16]
        assert str(outcomes[1].error) == "-3 is negative"
        assert all(outcome.n_bytes > 10 for outcome in outcomes)
        with pytest.raises(ValueError, match="-3 is negative"):
            list(executor.map(square, [1, -3]))


def test_workers_keep_to_their_share_of_the_cores() -> None:
    with LocalProcesses(2, threads=3) as executor:
        assert list(executor.map(thread_limits, range(2))) == [["3", "3", "3"]] * 2
    workers, threads = Placement(workers=1000, threads=8).local()
    assert (workers, threads) == (1000, 1)


def test_a_worker_that_is_killed_is_replaced_and_its_task_repeated(tmp_path: Path) -> None:
    events = []
    with LocalProcesses(1, threads=1) as executor:
        markers = [str(tmp_path / f"{i}") for i in range(3)]
        done = list(executor.run(die_once, markers, lambda index, text: events.append((index, text))))
        assert [outcome.error for outcome in done] == [None] * 3
        assert len({outcome.value for outcome in done}) == 3
    assert events.count((0, "surface")) == 2


def test_a_task_that_kills_its_worker_twice_is_given_up_with_its_stage() -> None:
    with LocalProcesses(2, threads=1) as executor:
        first, second = sorted(executor.run(die, [0, 1]), key=lambda outcome: outcome.index)
        assert isinstance(first.error, WorkerLostError)
        assert isinstance(second.error, WorkerLostError)
        assert (
            "by signal SIGKILL in stage surface, 2 times; this is most often a lack of memory: fewer --workers"
            in str(first.error)
        )
        assert list(executor.map(square, [3])) == [9]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system does not tell what a process holds")
def test_memory_of_a_worker_is_limited() -> None:
    with LocalProcesses(1, threads=1, memory_mb=300) as executor:
        (outcome,) = executor.run(fill, [400_000_000])
        assert isinstance(outcome.error, OutOfMemoryError)
        assert re.search(
            r"out of memory in stage surface: its process held \d+ MB, and --memory-mb allows 300; give more, "
            r"or fewer --workers, smaller images",
            str(outcome.error),
        )
        assert list(executor.map(fill, [1000])) == [1000]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system does not tell what a process holds")
@pytest.mark.parametrize("workers_mb", [20, 100])
def test_memory_that_is_too_little_for_the_code_is_told_as_such(specimens: Path, tmp_path: Path, workers_mb) -> None:
    """Where a limit of the system is set on them, libraries crash, hang or blame something else while they load."""
    output = tmp_path / "out"
    with open_executor(Placement(workers=1, memory_mb=workers_mb)) as executor:
        endings = run_batch(find_specimens(specimens, output), output, QUICK, executor, Silence())
    for ending in endings:
        assert ending.record.exit_code == 3
        assert "out of memory before its first stage: its process held" in ending.record.reason
        assert f"--memory-mb allows {workers_mb}; give more, or fewer --workers" in ending.record.reason
    with open_executor(Placement(workers=1)) as executor:  # which is no answer about the data
        endings = run_batch(find_specimens(specimens, output)[:1], output, QUICK, executor, Silence())
    assert [ending.record.state for ending in endings] == ["done"]


def test_a_crash_is_told_with_its_signal() -> None:
    with LocalProcesses(1, threads=1, memory_mb=4000) as executor:
        (outcome,) = executor.run(crash, [0])
    assert "by signal SIGABRT before its first stage, 2 times" in str(outcome.error)


def test_what_a_worker_prints_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with LocalProcesses(1, threads=1) as executor:
        list(executor.run(complain, [0]))
        until = time.monotonic() + 20
        while not caplog.messages and time.monotonic() < until:
            time.sleep(0.01)
    assert caplog.messages == ["worker: a library's complaint"]


def test_bytes_are_counted_with_the_function_that_each_process_gets_once() -> None:
    large = partial(add, bytes(100_000))
    with LocalProcesses(1, threads=1) as executor:
        first, second = executor.run(large, [b"x" * 5_000, b"x" * 7_000])
        assert 110_000 < first.n_bytes < 111_000  # 100,000 + 5,000 there, 5,000 back
        assert 14_000 < second.n_bytes < 15_000
        counted = Counted(executor)
        assert list(counted.map(large, [b"1", b"2"])) == [b"1", b"2"]
    assert 0 < counted.n_bytes < 1000  # the process has the function already
    assert [one.n_bytes > 100_000 for one in Serial().run(large, [b"1", b"2"])] == [True, False]


def test_workers_end_with_their_master() -> None:
    code = (
        "import os, sys; from semscape.cluster.processes import LocalProcesses; from worker_tasks import sleep\n"
        "with LocalProcesses(1, 1) as executor:\n"
        "    print(*executor.map(sleep, [0.0]), flush=True)\n"
        "    list(executor.map(sleep, [600.0]))\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], env=worker_environment(1), stdout=subprocess.PIPE) as master:
        assert master.stdout is not None
        worker = int(master.stdout.readline())
        master.kill()
    until = time.monotonic() + 20
    while _lives(worker) and time.monotonic() < until:
        time.sleep(0.02)
    assert not _lives(worker)


def _lives(process: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


def test_stages_of_one_specimen_on_processes_give_the_same(master_images: Path) -> None:
    series = load_series(master_images)
    with local_mapper(1) as one:
        alone = reconstruct(series, QUICK, mapper=one)
    with LocalProcesses(2, threads=1) as executor:
        spread = reconstruct(series, QUICK, mapper=executor.map)
    assert (alone.height_map.height_um.tobytes(), alone.reconstruction.points_um.tobytes()) == (
        spread.height_map.height_um.tobytes(),
        spread.reconstruction.points_um.tobytes(),
    )


# Dask


@dataclass
class Cluster:
    address: str
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Start a scheduler and two workers, as processes, without the nannies that would start a killed one again."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("dask")
    information = folder / "scheduler.json"
    quiet = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": worker_environment(1)}
    with contextlib.ExitStack() as stack:

        def start(*arguments: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen([sys.executable, "-m", "dask", *arguments], **quiet)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        told = ["--scheduler-file", str(information), "--no-dashboard"]
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show", *told)
        worker = ["worker", "--nthreads", "1", "--no-nanny", *told]
        workers = [start(*worker), start(*worker)]
        until = time.monotonic() + 60
        while not (information.exists() and information.stat().st_size) and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(0.2)
        address = json.loads(information.read_text())["address"]
        import distributed

        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield Cluster(address, workers)


def copies(master_images: Path, root: Path, count: int) -> Path:
    """Make specimens of the same images under links; their names and folders differ."""
    root.mkdir()
    for i in range(count):
        (root / f"s{i}").symlink_to(master_images)
    return root


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_dask_with_a_worker_killed_in_mid_run(cluster: Cluster, master_images, tmp_path, undisturbed) -> None:
    root, output = copies(master_images, tmp_path / "set", 4), tmp_path / "out"
    specimens = find_specimens(root, output)

    told: list[str] = []
    stages: set[tuple[str, str]] = set()

    class Killer(Silence):
        def event(self, name: str, stage: str) -> None:
            stages.add((name, stage))

        def ended(self, ending: Ending) -> None:
            told.append(ending.record.name)
            if len(told) == 1:
                cluster.workers[0].send_signal(signal.SIGKILL)

    with open_executor(Placement(scheduler=cluster.address)) as executor:
        assert executor.workers == 2
        assert list(executor.map(square, range(5))) == [0, 1, 4, 9, 16]
        large = list(executor.run(partial(add, bytes(200_000)), [b"1", b"2"]))  # the function goes to each worker once
        assert sorted(outcome.value for outcome in large) == [b"1", b"2"]
        assert 400_000 < sum(outcome.n_bytes for outcome in large) < 402_000
        endings = run_batch(specimens, output, QUICK, executor, Killer())
        expected = {(f"s{i}", stage) for i in range(4) for stage in ("", "match", "report")}
        until = time.monotonic() + 30
        while not expected <= stages and time.monotonic() < until:
            time.sleep(0.05)  # Dask sends events beside the results, and later on a machine that is busy
    assert [ending.record.name for ending in endings] == [f"s{i}" for i in range(4)]
    assert sorted(told) == [f"s{i}" for i in range(4)]
    assert expected <= stages
    for ending in endings:
        assert ending.record.state == "done", ending.record.reason
        assert products(output / ending.record.name) == undisturbed
        assert 500 < ending.n_bytes < 10_000  # a few names and figures; the images stay where they are
    assert not [path for path in output.rglob("*") if path.name.startswith(".")]


def test_no_scheduler_and_wrong_requests() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(BadInputError, match="not both"), open_executor(Placement(scheduler="tcp://x", slurm="cores=1")):
        pass
    with pytest.raises(BadInputError, match="--workers is for this machine"):
        open_executor(Placement(workers=3, scheduler="tcp://x")).__enter__()
    for text, message in (
        ("cores=4", "memory is missing"),
        ("cores=4,memory=8GB,queue=x", "'queue=x' is none of partition"),
        ("cores=0,memory=8GB", "cores must be a whole number above 0"),
        ("cores=1,memory=much", "memory must be like 32GB"),
    ):
        with pytest.raises(BadInputError, match=message):
            slurm_request(text)


def test_slurm_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("dask_jobqueue")
    monkeypatch.setenv("PATH", str(tmp_path))
    with (
        pytest.raises(BadInputError, match="there is no sbatch here"),
        open_executor(Placement(slurm="cores=1,memory=1GB")),
    ):
        pass


# A whole batch


def test_processes_give_the_same_bytes_as_one_run_alone(master_images: Path, tmp_path: Path, undisturbed) -> None:
    """As `Serial` does in test_batch, and Dask above."""
    root, output = copies(master_images, tmp_path / "set", 2), tmp_path / "out"
    with open_executor(Placement(workers=2)) as executor:
        endings = run_batch(find_specimens(root, output), output, QUICK, executor, Silence())
    assert [(ending.record.state, ending.record.reason) for ending in endings] == [("done", "")] * 2
    for specimen in ("s0", "s1"):
        assert products(output / specimen) == undisturbed


def test_a_batch_that_is_terminated_goes_on_where_it_was(master_images: Path, tmp_path: Path, undisturbed) -> None:
    root, output = copies(master_images, tmp_path / "set", 3), tmp_path / "out"
    (tmp_path / "options.toml").write_text(QUICK.to_toml())
    command = [sys.executable, "-m", "semscape", "batch", root, "-o", output, "--workers", "1"]
    command += ["--options", tmp_path / "options.toml"]
    with subprocess.Popen(command, env=worker_environment(1), stderr=subprocess.PIPE, text=True) as process:
        until = time.monotonic() + 60
        while not (output / "s1" / WORK_NAME).exists() and time.monotonic() < until:
            time.sleep(0.01)
        threads = Path(f"/proc/{process.pid}/task").iterdir()
        workers = [int(child) for thread in threads for child in (thread / "children").read_text().split()]
        process.send_signal(signal.SIGTERM)
        time.sleep(0.2)  # of signals that wait at one time Python hears the interrupt first
        for number in (signal.SIGTERM, signal.SIGINT) * 20:  # by somebody in a hurry, and by SLURM
            time.sleep(0.005)
            process.send_signal(number)
        assert process.stderr is not None
        told = process.stderr.read()
    assert process.returncode == 143, told
    assert "run the same command again to go on" in told
    assert workers
    assert not [worker for worker in workers if _lives(worker)]
    states = re.findall(r"^s\d,(\w+)", (output / "summary.csv").read_text(), re.MULTILINE)
    assert states[0] == "done"
    assert states[2] == "waiting"
    with Path(os.devnull).open("w") as nowhere:
        from rich.console import Console

        code = run_command(
            root,
            output,
            QUICK,
            Placement(workers=0),
            Console(file=nowhere),
            quiet=True,
            retry_failed=False,
            verify=False,
            spread=False,
        )
    assert code == 0
    for name in ("s0", "s1", "s2"):
        assert products(output / name) == undisturbed
    kept = re.findall(r"^s\d,done,(\w+)", (output / "summary.csv").read_text(), re.MULTILINE)
    assert kept[0] == "yes"
    assert kept[2] == "no"


def test_ten_thousand_tasks_that_do_nothing() -> None:
    """Neither the queue nor the pipes fill up and block."""
    with LocalProcesses(2, threads=1) as executor:
        indices = [outcome.index for outcome in executor.run(nothing, range(10_000))]
    assert sorted(indices) == list(range(10_000))
    assert len(list(Serial().run(nothing, range(10)))) == 10
