"""Calculations in this process, and runs that end when a test says so."""

from __future__ import annotations

import shutil
import threading
import time
from pathlib import Path
from typing import Any

from semscape.app import calculations
from semscape.app.workspace import Run


class InlineDesk:
    """A desk whose calculations run at once, in this process."""

    def __enter__(self) -> InlineDesk:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def do(self, name: str, *arguments: Any) -> Any:
        return getattr(calculations, name)(*arguments)


class HeldJob:
    """A run that ends when it is told to, with the result that lies ready, or as it is told."""

    def __init__(self, run: Run, result: Path) -> None:
        self.run, self._result = run, result
        self.error: Exception | None = None
        self.go = threading.Event()
        self.stopped = False

    def wait(self) -> None:
        assert self.go.wait(20)
        if self.stopped:
            raise RuntimeError("stopped")
        if self.error is not None:
            raise self.error
        shutil.copytree(self._result, self.run.folder, dirs_exist_ok=True)

    def stop(self) -> None:
        self.stopped = True
        self.go.set()


class Jobs:
    """The jobs that a queue has started, in their order."""

    def __init__(self, result: Path) -> None:
        self._result = result
        self.started: list[HeldJob] = []
        self.free = False

    def job(self, number: int) -> HeldJob:
        """Return one of them as soon as it has been started."""
        until = time.monotonic() + 20
        while len(self.started) <= number:
            assert time.monotonic() < until
            time.sleep(0.01)
        return self.started[number]

    def __call__(self, run: Run) -> HeldJob:
        job = HeldJob(run, self._result)
        self.started.append(job)
        if self.free:
            job.go.set()
        return job
