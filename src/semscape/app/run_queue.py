"""The queue of runs: one at a time, in the order in which they were asked for, on disk, so that it outlives the app.

What waits and what is being made stands in each run's own state; there is no other file to lose. After a crash, or the
end of the app, a run that was being made waits again and goes on behind its last finished stage.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from semscape.app.run_state import State
from semscape.app.workspace import BusyRunError, Run, UnknownRunError, Workspace
from semscape.errors import BadInputError, SemscapeError, verdict_of
from semscape.options import Options

_log = logging.getLogger(__name__)


class Job(Protocol):
    """A run that is being made elsewhere."""

    def wait(self) -> None:
        """Return when the run folder is complete; raise what went wrong."""
        ...

    def stop(self) -> None:
        """Make `wait` return soon, by an error."""
        ...


class RunQueue:
    """Makes the runs of a workspace; to be used as a context manager, which begins and stops.

    Parameters
    ----------
    workspace : Workspace
    start_job : callable
        Starts to make a run.
    at_once : int
        Number of runs that are made side by side.
    """

    def __init__(self, workspace: Workspace, start_job: Callable[[Run], Job], at_once: int = 1) -> None:
        self._workspace, self._start_job = workspace, start_job
        self._changed = threading.Condition(threading.RLock())
        self._jobs: dict[str, Job] = {}
        self._cancelled: set[str] = set()
        self._closing = False
        self._threads = [threading.Thread(target=self._serve, daemon=True) for _ in range(at_once)]

    def __enter__(self) -> RunQueue:
        for run in self._workspace.runs():
            if run.state.state == "running":
                self._put(run, "queued")
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._closing = True
            jobs = list(self._jobs.values())
            self._changed.notify_all()
        for job in jobs:
            job.stop()
        for thread in self._threads:
            thread.join(10.0)

    @property
    def lock(self) -> threading.Condition:
        """To be held while a run's state is read and changed."""
        return self._changed

    def submit(self, name: str, settings: Sequence[str] = ()) -> Run:
        """Let a run wait for its turn.

        Raises
        ------
        BadInputError
            If it has fewer than two images, or a setting is not understood.
        BusyRunError
            If it waits already, or is being made.
        """
        Options().with_settings(list(settings))
        with self._changed:
            run = self._workspace.run(name)
            run.require_images()
            if run.state.is_busy:
                raise BusyRunError("this run waits already, or is being made")
            if len(run.image_names()) < 2:
                raise BadInputError(
                    f"{len(run.image_names())} image(s): a height needs at least two images of the specimen, at "
                    "different tilts; add the others"
                )
            waiting = replace(run.state, settings=tuple(settings), ticket=time.time_ns())
            run = self._put(replace(run, state=waiting), "queued")
            self._changed.notify_all()
            return run

    def cancel(self, name: str) -> Run:
        """Stop a run, or take it out of the queue; what is finished of it is kept.

        Raises
        ------
        BusyRunError
            If it neither waits nor is being made.
        """
        with self._changed:
            run = self._workspace.run(name)
            if not run.state.is_busy:
                raise BusyRunError("this run neither waits nor is being made: there is nothing to cancel")
            job = self._jobs.get(name)
            if job is not None:
                self._cancelled.add(name)
            run = self._put(run, "cancelled", "cancelled; what is finished is kept, and Go on continues there")
        if job is not None:
            job.stop()
        return run

    def waiting(self) -> list[str]:
        """Return the names of the runs that wait, the next one first."""
        runs = [run for run in self._workspace.runs() if run.state.state == "queued" and run.images is not None]
        return [run.name for run in sorted(runs, key=lambda run: (run.state.ticket, run.name))]

    def _serve(self) -> None:
        while True:
            with self._changed:
                run = None
                while not self._closing and (run := self._next()) is None:
                    self._changed.wait(5.0)  # another program may have put a run there
                if self._closing or run is None:
                    return
                try:
                    run = self._put(run, "running")
                    self._jobs[run.name] = job = self._start_job(run)
                except Exception as error:  # noqa: BLE001 (one run's failure must not stop the queue)
                    self._finish(run, error)
                    continue
            try:
                job.wait()
                self._finish(run, None)
            except Exception as error:  # noqa: BLE001 (one run's failure, whatever it is, must not stop the queue)
                self._finish(run, error)

    def _next(self) -> Run | None:
        try:
            # A run that was cancelled and asked for again waits until its first worker has ended.
            names = [name for name in self.waiting() if name not in self._jobs]
            return self._workspace.run(names[0]) if names else None
        except (OSError, BadInputError):
            return None

    def _finish(self, run: Run, error: Exception | None) -> None:
        with self._changed:
            self._jobs.pop(run.name, None)
            was_cancelled = run.name in self._cancelled
            self._cancelled.discard(run.name)
            self._changed.notify_all()
            if (was_cancelled or self._closing) and error is not None:
                return  # its state says so already, or that it is to go on when the app starts again
            try:
                if error is None:
                    self._put(run, "done", edited=False)
                else:
                    if not isinstance(error, SemscapeError):
                        _log.error("the run %s failed", run.name, exc_info=error)
                    self._put(run, "failed", verdict_of(error)[1])
            except (OSError, UnknownRunError, BadInputError) as unwritable:
                _log.error("the state of %s cannot be kept: %s", run.name, unwritable)

    def _put(self, run: Run, state: State, message: str = "", edited: bool | None = None) -> Run:
        was_edited = run.state.edited if edited is None else edited
        return self._workspace.put_state(run, replace(run.state, state=state, message=message, edited=was_edited))
