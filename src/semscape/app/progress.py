"""How far a run is, read from the log that it writes: so a page that opens late, or again, sees the same."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from semscape.io.run_folder import plain_json

STAGES = ("detect", "match", "calibrate", "surface", "mesh", "report")
"""The stages of a run in their order."""

_MOST_BYTES = 2_000_000


@dataclass(frozen=True)
class StageProgress:
    """A stage that has begun: when (seconds since 1970), how long it took (None while it goes on), its figures."""

    name: str
    began_s: float
    seconds: float | None
    figures: dict[str, Any]


def read_progress(log: Path) -> tuple[StageProgress, ...]:
    """Return the stages that have begun, by the last start of the run; none where there is no log.

    Examples
    --------
    >>> read_progress(Path("no-such-file"))
    ()
    """
    try:
        with log.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - _MOST_BYTES))
            lines = file.read().splitlines()
    except OSError:
        return ()
    stages: dict[str, StageProgress] = {}
    for line in lines:
        told = _told(line)
        name = told.get("stage")
        if name not in STAGES or told.get("logger") != "semscape.run":
            continue
        message, time_s = str(told.get("message", "")), _seconds(told.get("time"))
        if message.endswith(" begins"):
            if name == STAGES[0]:
                stages.clear()  # a run that goes on after an interruption begins its log anew
            stages[name] = StageProgress(name, time_s, None, {})
        elif message.endswith(" ended") and name in stages:
            figures = plain_json(told.get("figures"))  # a log may hold NaN, which is no JSON
            taken = max(0.0, round(time_s - stages[name].began_s, 3))
            stages[name] = StageProgress(
                name, stages[name].began_s, taken, figures if isinstance(figures, dict) else {}
            )
    return tuple(stages.values())


def _told(line: bytes) -> dict[str, Any]:
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def _seconds(text: Any) -> float:
    try:
        return datetime.fromisoformat(text).timestamp()
    except (TypeError, ValueError):
        return 0.0
