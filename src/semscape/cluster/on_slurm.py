"""Dask workers that SLURM starts (extra `cluster`), replaced when their jobs end before the batch does."""

from __future__ import annotations

import logging
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from semscape.cluster.on_dask import OnDask, import_distributed
from semscape.errors import BadInputError
from semscape.io.run_folder import make_folder

_KEYS = ("partition", "cores", "memory", "jobs", "walltime", "account")
_FORM = "write partition=NAME,cores=8,memory=32GB,jobs=4"
_POLL_S = 1.0
_PATIENCE_S = 10.0
_RENEW_S = 20.0  # longer than Dask's own "lost-worker-timeout", which gives a lost job's name free after 15 s
_log = logging.getLogger("semscape.cluster")


@contextmanager
def slurm(request: str, threads: int | None, memory_mb: int, logs: Path) -> Iterator[OnDask]:
    """Let SLURM start Dask workers, like "partition=main,cores=8,memory=32GB,jobs=4".

    `cores` and `memory` are those of one job; a job works on cores / threads specimens at a time. `jobs` is how many
    jobs are asked for (1), `walltime` and `account` are SLURM's. What the jobs print goes to the folder `logs`. A job
    that ends before the batch, as by its walltime, is asked for again.

    Raises
    ------
    BadInputError
        For a request that is not of this form, or that SLURM refuses, if the jobs end before a worker has come, or
        where SLURM or the extra `cluster` is not installed.
    """
    wanted = slurm_request(request)
    distributed = import_distributed()
    import dask
    from dask_jobqueue import SLURMCluster

    if shutil.which("sbatch") is None:
        raise BadInputError("--slurm: there is no sbatch here; start the batch on a machine that submits jobs to SLURM")
    cores = int(wanted["cores"])
    each = min(cores, threads or 1)
    n_jobs = int(wanted.get("jobs", "1"))
    pattern = str(logs.absolute()).replace("%", "%%") + "/slurm-%j.log"
    with SLURMCluster(
        queue=wanted.get("partition"),
        account=wanted.get("account"),
        walltime=wanted.get("walltime", "24:00:00"),
        job_cpu=cores,
        cores=max(1, cores // each),
        processes=1,
        memory=wanted["memory"],
        job_extra_directives=[*dask.config.get("jobqueue.slurm.job-extra-directives", []), f'--output="{pattern}"'],
    ) as cluster:
        _require_accepted(cluster.job_script())
        make_folder(logs)
        with distributed.Client(cluster, set_as_default=False) as client:
            cluster.scale(jobs=n_jobs)
            _wait_for_a_worker(client, cluster, logs)
            with _renewed(cluster, n_jobs):
                yield OnDask(client, each, memory_mb)


def slurm_request(text: str) -> dict[str, str]:
    """Return the keys and values of a `--slurm` text.

    Raises
    ------
    BadInputError
        For unknown or missing keys, and values that are none.

    Examples
    --------
    >>> slurm_request("partition=main,cores=8,memory=32GB")
    {'partition': 'main', 'cores': '8', 'memory': '32GB'}
    """
    wanted: dict[str, str] = {}
    for item in text.split(","):
        key, _, value = (part.strip() for part in item.partition("="))
        if key not in _KEYS or not value:
            raise BadInputError(f"--slurm {text!r}: {item!r} is none of {', '.join(_KEYS)}; {_FORM}")
        wanted[key] = value
    for key in ("cores", "memory"):
        if key not in wanted:
            raise BadInputError(f"--slurm {text!r}: {key} is missing; {_FORM}")
    for key in ("cores", "jobs"):
        if key in wanted and not (wanted[key].isdecimal() and int(wanted[key]) > 0):
            raise BadInputError(f"--slurm {text!r}: {key} must be a whole number above 0; {_FORM}")
    if not re.fullmatch(r"\d+(\.\d+)? ?[MGT]i?B", wanted["memory"]):
        raise BadInputError(f"--slurm {text!r}: memory must be like 32GB or 900MB; {_FORM}")
    return wanted


def _require_accepted(script: str) -> None:
    """Have SLURM look at a job without taking it: Dask would only log a refusal, and wait for ever."""
    done = subprocess.run(["sbatch", "--test-only"], input=script, capture_output=True, text=True, check=False)
    if done.returncode:
        told = done.stderr.strip().replace("sbatch: error: ", "").replace("\n", "; ")
        raise BadInputError(f"--slurm: SLURM refuses such a job: {told}")


def _wait_for_a_worker(client: Any, cluster: Any, logs: Path) -> None:
    start = time.monotonic()
    told = False
    while not client.nthreads():
        jobs = _job_ids(cluster)
        if jobs and not jobs.keys() & _queued(jobs):
            ended = ", ".join(sorted(jobs))
            raise BadInputError(f"SLURM's jobs ({ended}) ended before a worker came; {logs} holds what they printed")
        if not told and time.monotonic() - start > _PATIENCE_S:
            _log.warning("waiting for SLURM to start a job (%s); squeue tells why", ", ".join(sorted(jobs)))
            told = True
        time.sleep(_POLL_S)


@contextmanager
def _renewed(cluster: Any, n_jobs: int) -> Iterator[None]:
    """Ask for another job whenever one has ended: by its walltime, with its node, cancelled before it began."""
    ended = threading.Event()

    def renew() -> None:
        gone: set[str] = set()
        while not ended.wait(_RENEW_S):
            jobs = _job_ids(cluster)
            gone_before, gone = gone, jobs.keys() - _queued(jobs)
            for job in gone & gone_before:  # seen twice, for Dask itself clears away those whose workers had come
                cluster.loop.add_callback(cluster.workers.pop, jobs[job], None)
            if gone:
                _log.warning("SLURM's job %s has ended before the batch; another is asked for", ", ".join(sorted(gone)))
            cluster.scale(jobs=n_jobs)

    thread = threading.Thread(target=renew, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _job_ids(cluster: Any) -> dict[str, Any]:
    """Return the names that Dask gave to its jobs, by SLURM's numbers of them."""
    return {job.job_id: name for name, job in list(cluster.workers.items()) if job.job_id}


def _queued(jobs: dict[str, Any]) -> set[str]:
    """Return which of the jobs are waiting or running; all of them while SLURM gives no answer."""
    done = subprocess.run(["squeue", "--noheader", "--me", "--format=%i"], capture_output=True, text=True, check=False)
    return set(done.stdout.split()) if done.returncode == 0 else set(jobs)
