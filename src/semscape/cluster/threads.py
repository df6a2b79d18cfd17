"""Threads of this process: run independent tasks of one specimen side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

Mapper = Callable[..., Iterable[Any]]


@contextmanager
def local_mapper(workers: int | None = None) -> Iterator[Mapper]:
    """Give a `map` that keeps the order of its results and runs on `workers` threads.

    Threads serve because NumPy, OpenCV and the compiled kernels release the interpreter's lock. Results do not
    depend on the number of workers: every task has its own random stream and shares nothing.

    Parameters
    ----------
    workers : int, optional
        Number of threads; by default one per core.

    Raises
    ------
    ValueError
        For fewer than one worker.

    Examples
    --------
    >>> with local_mapper(2) as mapper:
    ...     list(mapper(abs, [-1, 2]))
    [1, 2]
    """
    count = (os.cpu_count() or 1) if workers is None else workers
    if count < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if count == 1:
        yield map
        return
    with ThreadPoolExecutor(count) as pool:
        yield pool.map
