from __future__ import annotations

import io

from rich.console import Console

from semscape.batch.record import Ending, Record
from semscape.batch.table import BatchTable


def ending(name: str, state: str, *, kept: bool, verdict: str = "", reason: str = "") -> Ending:
    record = Record(name, "failed" if state == "failed" else "done", "", {}, reason=reason, report={"verdict": verdict})
    return Ending(record, kept, n_bytes=3000)


def test_long_reasons_leave_names_and_states_readable() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=80, color_system=None)
    with BatchTable(console, 300, quiet=False) as table:
        for name in ("grain-0", "grain-1", "grain-2", "grain-3"):
            table.event(name, "")
        table.event("grain-3", "surface")
        table.ended(ending("grain-0", "done", kept=False, verdict="good: heights to +-2.3%"))
        table.ended(ending("grain-1", "failed", kept=False, reason="two images, " * 20))
        table.ended(ending("grain-2", "done", kept=True, verdict="usable"))
        told = table.closing_line()
    last = console.file.getvalue().rsplit("3 of 300 specimens: 1 done, 1 kept, 1 failed", 1)[1]  # type: ignore[attr-defined]
    lines = [line.split() for line in last.splitlines()]
    starts = [line[:2] for line in lines if line and line[0].startswith("grain")]
    assert starts == [["grain-0", "done"], ["grain-1", "failed"], ["grain-2", "kept"], ["grain-3", "surface"]]
    assert all(len(line) <= 80 for line in last.splitlines())
    assert told.startswith("1 done, 1 kept from before, 1 failed, 297 waiting; ")
    assert told.endswith("3.0 kB sent per specimen")
