"""Which executor is meant: by flags to an open executor."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from semscape.cluster.executor import Executor, Serial
from semscape.cluster.processes import LocalProcesses
from semscape.errors import BadInputError


@dataclass(frozen=True)
class Placement:
    """Where tasks run: local processes, or on a Dask `scheduler`, or on workers that `slurm` starts.

    `workers` is the number of local processes (0: in this process, None: one per core), `threads` the threads of
    each task (None: its share of the cores), `memory_mb` the most memory that a task may hold (0: no limit). What
    SLURM's jobs print goes to the folder `logs`.
    """

    workers: int | None = None
    threads: int | None = None
    memory_mb: int = 0
    scheduler: str | None = None
    slurm: str | None = None
    logs: Path = Path("slurm")

    def local(self) -> tuple[int, int]:
        """Return the number of local processes and the threads of each; together they fill the cores, not more.

        Examples
        --------
        >>> Placement(workers=1, threads=1).local()
        (1, 1)
        """
        cores = usable_cores()
        workers = max(1, cores // (self.threads or 1)) if self.workers is None else max(1, self.workers)
        share = max(1, cores // workers)
        return workers, min(self.threads or share, share)


def usable_cores() -> int:
    """Return how many cores this process may use, which on a shared node are fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def open_executor(placement: Placement) -> Iterator[Executor]:
    """Open the executor that is asked for, and end its processes and connections afterwards.

    Raises
    ------
    BadInputError
        If two places are asked for, or the cluster cannot be reached.
    """
    if placement.scheduler and placement.slurm:
        raise BadInputError("give either --scheduler or --slurm, not both")
    if (placement.scheduler or placement.slurm) and placement.workers is not None:
        raise BadInputError("--workers is for this machine; on a cluster Dask or SLURM says how many work")
    workers, threads = placement.local()
    if placement.scheduler:
        from semscape.cluster.on_dask import connected

        with connected(placement.scheduler, placement.threads or 1, placement.memory_mb) as on_dask:
            yield on_dask
    elif placement.slurm:
        from semscape.cluster.on_slurm import slurm

        with slurm(placement.slurm, placement.threads, placement.memory_mb, placement.logs) as on_dask:
            yield on_dask
    elif placement.workers == 0:
        yield Serial(threads)
    else:
        with LocalProcesses(workers, threads, placement.memory_mb) as processes:
            yield processes
