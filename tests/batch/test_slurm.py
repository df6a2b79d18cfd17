"""`semscape batch --slurm` on a real SLURM of one node; an optional step, `make slurm` (see slurm_cluster.sh)."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from run_products import QUICK, products
from semscape.batch.folder_run import reconstruct_folder
from semscape.cluster.processes import worker_environment
from semscape.io.simulated import write_simulated_series
from semscape.simulate import SimulationOptions, simulate

pytestmark = pytest.mark.skipif(
    os.environ.get("SEMSCAPE_CI_SLURM") != "1", reason="a SLURM is only started where SEMSCAPE_CI_SLURM=1"
)

_TINY = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=128, height_px=128)
_N_SPECIMENS = 20
_SCRIPT = Path(__file__).with_name("slurm_cluster.sh")
_REQUEST = "partition=main,cores=1,memory=2GB"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Start the daemons; give the environment in which SLURM's commands find them."""
    folder = tmp_path_factory.mktemp("slurm")
    try:
        with (folder / "start.log").open("wb") as log:  # no pipe, which the daemons would keep open
            started = subprocess.run([_SCRIPT, "start", folder], stdout=log, stderr=log, check=False)
        assert started.returncode == 0, (folder / "start.log").read_text(encoding="utf-8")
        yield worker_environment(threads=1) | {"SLURM_CONF": str(folder / "slurm.conf")}
    finally:
        subprocess.run([_SCRIPT, "stop", folder], check=True)


def batch(specimens: Path, output: Path, request: str, environment: dict[str, str]) -> subprocess.Popen[str]:
    options = specimens.parent / "options.toml"
    options.write_text(QUICK.to_toml(), encoding="utf-8")
    command = [sys.executable, "-m", "semscape", "batch", specimens, "-o", output, "--options", options]
    return subprocess.Popen(
        [*command, "--slurm", request], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def asked(environment: dict[str, str], *command: str) -> list[str]:
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_twenty_specimens_though_a_job_is_cancelled(environment: dict[str, str], tmp_path: Path) -> None:
    specimens, output = tmp_path / "set", tmp_path / "an output"
    names = [f"s{i:02}" for i in range(_N_SPECIMENS)]
    for seed, name in enumerate(names):
        write_simulated_series(specimens / name, *simulate("fracture", _TINY, rng=seed))
    with batch(specimens, output, f"{_REQUEST},jobs=1", environment) as process:
        assert process.stdout is not None
        told = [process.stdout.readline() for _ in range(3)]
        (job,) = asked(environment, "squeue", "--noheader", "--format=%i")
        asked(environment, "scancel", job)
        told += process.stdout.readlines()
    assert process.returncode == 0, told
    assert "20 done, 0 kept from before, 0 failed" in told[-2]
    assert f"SLURM's job {job} has ended before the batch; another is asked for" in "".join(told)
    with (output / "summary.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["name"], row["state"]) for row in rows] == [(name, "done") for name in names]
    assert all(500 < int(row["bytes_sent"]) < 10_000 for row in rows)
    assert len(list((output / "records").glob("slurm-*.log"))) == 2
    for name in (names[0], names[-1]):
        reconstruct_folder(specimens / name, tmp_path / name, QUICK, workers=1)
        assert products(output / name) == products(tmp_path / name)
    until = time.monotonic() + 30
    while asked(environment, "squeue", "--noheader") and time.monotonic() < until:
        time.sleep(0.2)
    assert not asked(environment, "squeue", "--noheader")


@pytest.mark.parametrize(
    ("request_text", "more", "message"),
    [
        ("partition=nowhere,cores=1,memory=2GB", {}, "SLURM refuses such a job: invalid partition specified: nowhere"),
        ("cores=1,memory=900TB", {}, "SLURM refuses such a job: allocation failure"),
        (_REQUEST, {"DASK_JOBQUEUE__SLURM__JOB_SCRIPT_PROLOGUE": "['exit 3']"}, "ended before a worker came"),
    ],
)
def test_what_slurm_does_not_run_is_told(
    environment: dict[str, str], specimens: Path, tmp_path: Path, request_text: str, more: dict[str, str], message: str
) -> None:
    with batch(specimens, tmp_path / "out", request_text, environment | more) as process:
        told: Any = process.communicate(timeout=300)[0]
    assert process.returncode == 2
    assert message in told
    assert "Traceback" not in told
