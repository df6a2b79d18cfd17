"""A Dask cluster (extra `cluster`): tasks on the workers of a scheduler.

On each thread of a Dask worker a process of our own works, as it does on a local machine: with its share of the cores,
and with a memory of its own, so that a specimen that is too large ends that process and not the Dask worker.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from semscape.cluster.executor import Event, Outcome, WorkerLostError, in_order, outcome, pack
from semscape.cluster.processes import Worker
from semscape.errors import BadInputError

_LARGE_BYTES = 100_000
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
        Most memory that each task may hold, in MB; 0 is no limit.
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

        shared: Any = pack(function)
        n_once, n_each = 0, len(shared)
        if n_each > _LARGE_BYTES:  # goes to every worker once, not along with every task
            n_once, n_each = n_each * len(self._client.nthreads()), 0
            shared = self._client.scatter(shared, broadcast=True)
        requests = [pack(item) for item in items]
        topic = ""
        if on_event:
            topic = f"semscape-{uuid.uuid4()}"
            self._client.subscribe_topic(topic, lambda event: on_event(*event[1]))
        futures = self._client.map(
            ask_in_process,
            range(len(requests)),
            requests,
            topic=topic,
            shared=shared,
            threads=self.threads,
            memory_mb=self._memory_mb,
            pure=False,
        )
        index_of = {future.key: index for index, future in enumerate(futures)}
        for future in as_completed(futures, loop=self._client.loop):  # type: ignore[no-untyped-call]
            index = index_of[future.key]
            try:
                reply = future.result()
                yield outcome(index, n_once + n_each + len(requests[index]), reply)
                n_once = 0
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


def ask_in_process(index: int, request: bytes, topic: str, shared: bytes, threads: int, memory_mb: int) -> bytes:
    """Have a task done by the process that belongs to this thread of this Dask worker; tell its stages to `topic`."""
    from distributed import get_worker

    worker: Worker | None = getattr(_local, "worker", None)
    if worker is None:
        worker = _local.worker = Worker(threads, memory_mb)
    if not topic:
        return worker.ask(shared, request)
    log_event = get_worker().log_event
    log_event(topic, (index, ""))
    return worker.ask(shared, request, lambda text: log_event(topic, (index, text)))


@contextmanager
def connected(scheduler: str, threads: int, memory_mb: int) -> Iterator[OnDask]:
    """Connect to a scheduler by its address, like tcp://host:8786.

    Raises
    ------
    BadInputError
        If the extra `cluster` is not installed, no scheduler answers, or it has no worker.
    """
    client_class = import_distributed().Client
    try:
        client = client_class(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInputError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
    with client:
        if not client.nthreads():
            raise BadInputError(f"--scheduler {scheduler}: it has no worker; start one: dask worker {scheduler}")
        yield OnDask(client, threads, memory_mb)


def import_distributed() -> Any:
    """Return Dask's package, which the extra `cluster` brings.

    Raises
    ------
    BadInputError
        If it is not installed.
    """
    try:
        import dask

        dask.config.set({"logging.distributed": "warning"})  # else --log-json tells of every connection
        import distributed
    except ImportError as error:
        raise BadInputError("Dask is not installed; install semscape with its extra: semscape[cluster]") from error
    return distributed
