"""What a batch shows while it runs: a live table on a terminal, elsewhere a line for each specimen."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from semscape.batch.record import Ending
from semscape.report.console import print_line

_MOST_SHOWN = 12


class BatchTable:
    """The audience of `run_batch` on a console; a context manager.

    Parameters
    ----------
    console : rich.console.Console
        Where it is shown.
    total : int
        Number of specimens.
    quiet : bool
        Show nothing.
    """

    def __init__(self, console: Console, total: int, *, quiet: bool) -> None:
        self._console, self._total, self._quiet = console, total, quiet
        self._running: dict[str, tuple[str, float]] = {}
        self._counts = {"done": 0, "kept": 0, "failed": 0}
        self._bytes = 0
        self._last: list[Ending] = []
        self._start = time.monotonic()
        self._lock = threading.Lock()  # the executor's threads tell of stages
        self._live: Live | None = None

    def __enter__(self) -> BatchTable:
        if self._console.is_terminal and not self._quiet:
            self._live = Live(get_renderable=self._table, console=self._console, refresh_per_second=4)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()

    def event(self, name: str, stage: str) -> None:
        """Take note that a specimen starts ("") or begins a stage."""
        with self._lock:
            started = self._running.get(name, ("", time.monotonic()))[1]
            self._running[name] = (stage, started)

    def ended(self, ending: Ending) -> None:
        """Take note that a specimen has ended."""
        record = ending.record
        state = "failed" if record.state == "failed" else "kept" if ending.kept else "done"
        with self._lock:
            self._running.pop(record.name, None)
            self._counts[state] += 1
            self._bytes += ending.n_bytes
            self._last = [*self._last, ending][-_MOST_SHOWN:]
        if not self._live and not self._quiet:
            count = sum(self._counts.values())
            print_line(f"{count}/{self._total} {record.name}: {state}, {_short(ending)}", self._console)

    def closing_line(self) -> str:
        """Return the batch in one line."""
        seconds = time.monotonic() - self._start
        ran = max(1, sum(self._counts.values()))
        waiting = self._total - sum(self._counts.values())
        counts = [f"{self._counts['done']} done", f"{self._counts['kept']} kept from before"]
        counts += [f"{self._counts['failed']} failed"] + ([f"{waiting} waiting"] if waiting else [])
        return f"{', '.join(counts)}; {seconds:.1f} s, {self._bytes / ran / 1e3:.1f} kB sent per specimen"

    def _table(self) -> Table:
        with self._lock:
            running, last = dict(self._running), list(self._last)
            counts = dict(self._counts)
        ended = sum(counts.values())
        elapsed = time.monotonic() - self._start
        left = elapsed / ended * (self._total - ended) if ended else None
        told = ", ".join(f"{count} {state}" for state, count in counts.items())
        title = f"{ended} of {self._total} specimens: {told}"
        title += f"; {elapsed:.0f} s" + ("" if left is None else f", about {left:.0f} s to go")
        table = Table(title=title, title_justify="left", box=None, pad_edge=False, expand=True)
        for name in ("specimen", "state", "seconds"):
            table.add_column(name, justify="right" if name == "seconds" else "left", no_wrap=True)
        table.add_column("verdict", no_wrap=True, overflow="ellipsis", ratio=1)  # what the others leave
        for ending in last:
            record = ending.record
            style = "red" if record.state == "failed" else "green"
            state = "kept" if ending.kept and record.state == "done" else record.state
            table.add_row(Text(record.name), Text(state, style), f"{record.seconds:.1f}", Text(_short(ending)))
        now = time.monotonic()
        for name, (stage, started) in list(running.items())[:_MOST_SHOWN]:
            table.add_row(Text(name), Text(stage or "starts", "cyan"), f"{now - started:.1f}", "")
        return table


def _short(ending: Ending) -> str:
    record = ending.record
    return record.reason if record.state == "failed" else str(record.report.get("verdict", ""))
