"""A Dask cluster: a scheduler that runs already, or one whose workers SLURM starts (extra `cluster`).

On each thread of a Dask worker a process of our own works, as it does on a local machine: with its share of the cores,
and with a memory of its own, so that a specimen that is too large ends that process and not the Dask worker.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from semscape.cluster.executor import Event, Outcome, WorkerLostError, in_order, outcome, pack
from semscape.cluster.processes import Worker
from semscape.errors import BadInputError

_LARGE_BYTES = 100_000
_SLURM_KEYS = ("partition", "cores", "memory", "jobs", "walltime", "account")
_local = threading.local()


class OnDask:
    """Tasks on the workers of a Dask scheduler.

    Parameters
    ----------
    client : distributed.Client
        Connected to the scheduler.
    threads : int
        Threads of each task.
    memory_mb : int
        Most memory that each task may map, in MB; 0 is no limit.
    """

    def __init__(self, client: Any, threads: int, memory_mb: int = 0) -> None:
        self._client = client
        self._memory_mb = memory_mb
        self.threads = threads
        self.workers = max(1, sum(client.nthreads().values()))

    def run(
        self, function: Callable[[Any], Any], items: Iterable[Any], on_event: Event | None = None
    ) -> Iterator[Outcome]:
        """Yield the outcome of every item as they end; Dask itself repeats those whose worker dies."""
        from distributed import KilledWorker, as_completed

        del on_event  # what a task says stays with its Dask worker
        shared: Any = pack(function)
        if len(shared) > _LARGE_BYTES:  # goes to every worker once, not along with every task
            shared = self._client.scatter(shared, broadcast=True)
        requests = [pack(item) for item in items]
        futures = self._client.map(
            ask_in_process,
            requests,
            shared=shared,
            threads=self.threads,
            memory_mb=self._memory_mb,
            pure=False,
        )
        index_of = {future.key: index for index, future in enumerate(futures)}
        for future in as_completed(futures, loop=self._client.loop):  # type: ignore[no-untyped-call]
            index = index_of[future.key]
            try:
                yield outcome(index, requests[index], future.result())
            except KilledWorker as error:
                lost = WorkerLostError(
                    f"{error.allowed_failures + 1} Dask workers died one after the other while they worked on it; "
                    "this is most often a lack of memory: more memory per worker, or smaller images"
                )
                yield Outcome(index, None, lost, len(requests[index]))
            except WorkerLostError as error:
                yield Outcome(index, None, error, len(requests[index]))
            future.release()

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        """Yield the values in the order of the items."""
        return in_order(self.run(function, items))


def ask_in_process(request: bytes, shared: bytes, threads: int, memory_mb: int) -> bytes:
    """Have a task done by the process that belongs to this thread of this Dask worker."""
    worker: Worker | None = getattr(_local, "worker", None)
    if worker is None:
        worker = _local.worker = Worker(threads, memory_mb)
    return worker.ask(shared, request)


@contextmanager
def connected(scheduler: str, threads: int, memory_mb: int) -> Iterator[OnDask]:
    """Connect to a scheduler by its address, like tcp://host:8786.

    Raises
    ------
    BadInputError
        If the extra `cluster` is not installed, no scheduler answers, or it has no worker.
    """
    client_class = _distributed().Client
    try:
        client = client_class(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInputError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
    with client:
        if not client.nthreads():
            raise BadInputError(f"--scheduler {scheduler}: it has no worker; start one: dask worker {scheduler}")
        yield OnDask(client, threads, memory_mb)


@contextmanager
def slurm(request: str, threads: int | None, memory_mb: int) -> Iterator[OnDask]:
    """Let SLURM start Dask workers, like "partition=main,cores=8,memory=32GB,jobs=4".

    `cores` and `memory` are those of one job; a job works on cores / threads specimens at a time. `jobs` is how many
    jobs are asked for (1), `walltime` and `account` are SLURM's.

    Raises
    ------
    BadInputError
        For a request that is not of this form, or where the extra `cluster` is not installed.
    """
    wanted = slurm_request(request)
    distributed = _distributed()
    from dask_jobqueue import SLURMCluster

    cores = int(wanted["cores"])
    each = min(cores, threads or 1)
    with (
        SLURMCluster(
            queue=wanted.get("partition"),
            account=wanted.get("account"),
            walltime=wanted.get("walltime", "24:00:00"),
            job_cpu=cores,
            cores=max(1, cores // each),
            processes=1,
            memory=wanted["memory"],
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        cluster.scale(jobs=int(wanted.get("jobs", "1")))
        client.wait_for_workers(1)
        yield OnDask(client, each, memory_mb)


def slurm_request(text: str) -> dict[str, str]:
    """Return the keys and values of a `--slurm` text.

    Examples
    --------
    >>> slurm_request("partition=main,cores=8,memory=32GB")
    {'partition': 'main', 'cores': '8', 'memory': '32GB'}
    """
    form = "write partition=NAME,cores=8,memory=32GB,jobs=4"
    wanted: dict[str, str] = {}
    for item in text.split(","):
        key, _, value = (part.strip() for part in item.partition("="))
        if key not in _SLURM_KEYS or not value:
            raise BadInputError(f"--slurm {text!r}: {item!r} is none of {', '.join(_SLURM_KEYS)}; {form}")
        wanted[key] = value
    for key in ("cores", "memory"):
        if key not in wanted:
            raise BadInputError(f"--slurm {text!r}: {key} is missing; {form}")
    for key in ("cores", "jobs"):
        if key in wanted and not (wanted[key].isdecimal() and int(wanted[key]) > 0):
            raise BadInputError(f"--slurm {text!r}: {key} must be a whole number above 0; {form}")
    return wanted


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise BadInputError("Dask is not installed; install semscape with its extra: semscape[cluster]") from error
    return distributed
