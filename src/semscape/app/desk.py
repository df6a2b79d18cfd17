"""Processes that calculate for the app: a file that brings one down brings down neither the server nor another run."""

from __future__ import annotations

import os
import queue
from importlib import import_module
from typing import Any

from semscape.app.workspace import Run
from semscape.cluster.executor import outcome, pack
from semscape.cluster.processes import Worker


class Desk:
    """A few processes that stay and take one calculation after the other; to be used as a context manager.

    Parameters
    ----------
    workers : int
        Number of processes; each starts when it is first needed.
    threads : int
        Threads of each.
    """

    def __init__(self, workers: int = 2, threads: int = 1) -> None:
        self._workers = [Worker(threads) for _ in range(workers)]
        self._idle: queue.LifoQueue[Worker] = queue.LifoQueue()
        for worker in self._workers:
            self._idle.put(worker)

    def __enter__(self) -> Desk:
        return self

    def close(self) -> None:
        """End the processes for good; what they were asked for raises `WorkerLostError`."""
        for worker in self._workers:
            worker.close()

    def __exit__(self, *_: object) -> None:
        self.close()
        for worker in self._workers:
            worker.stop()

    def do(self, name: str, *arguments: Any) -> Any:
        """Return what a function of `semscape.app.calculations` returns in another process; raise what it raises.

        The server itself does not import those functions: it starts in half the time without them.

        Raises
        ------
        WorkerLostError
            If the process died of it.
        """
        worker = self._idle.get()
        try:
            return _asked(worker, name, *arguments)
        finally:
            self._idle.put(worker)


class ReconstructionJob:
    """A run that is made in a process of its own (see `semscape.app.run_queue.Job`)."""

    def __init__(self, run: Run, threads: int | None = None) -> None:
        self._run = run
        self._worker = Worker(threads or os.cpu_count() or 1)

    def wait(self) -> None:
        """Make the run.

        Raises
        ------
        SemscapeError
            As `reconstruct_folder` does, or if the process was ended.
        """
        run = self._run
        try:
            _asked(self._worker, "reconstruct", str(run.require_images()), str(run.folder), run.state.settings)
        finally:
            self._worker.stop()

    def stop(self) -> None:
        """End the process; the stages that it has finished are kept."""
        self._worker.close()


def _asked(worker: Worker, name: str, *arguments: Any) -> Any:
    request = pack((name, arguments))
    return outcome(0, len(request), worker.ask(_CALL, request)).result()


def _call(request: tuple[str, tuple[Any, ...]]) -> Any:
    name, arguments = request
    return getattr(import_module("semscape.app.calculations"), name)(*arguments)


_CALL = pack(_call)
