"""All runs as the list shows them, looked up once for all pages that are open."""

from __future__ import annotations

import json
import threading
import time

from semscape.app.run_queue import RunQueue
from semscape.app.summary import Summary, summarize
from semscape.app.workspace import UnknownRunError, Workspace

_LIFE_S = 0.3


class Snapshots:
    """The list of runs, at most a third of a second old."""

    def __init__(self, workspace: Workspace, queue: RunQueue) -> None:
        self._workspace, self._queue = workspace, queue
        self._lock = threading.Lock()
        self._text, self._made_s = "", -1.0

    def runs(self) -> list[Summary]:
        """Return all runs as they are now."""
        waiting = self._queue.waiting()
        found = []
        for name in self._workspace.names():
            try:
                found.append(summarize(self._workspace, self._workspace.run(name), waiting))
            except (OSError, UnknownRunError):  # removed in this very moment
                continue
        return found

    def text(self) -> str:
        """Return all runs as one line of JSON."""
        with self._lock:
            if time.monotonic() - self._made_s > _LIFE_S:
                self._text = json.dumps([run.model_dump() for run in self.runs()], allow_nan=False)
                self._made_s = time.monotonic()
            return self._text
