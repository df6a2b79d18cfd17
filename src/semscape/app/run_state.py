"""What the app remembers of a run beside what its folders hold: a small file among the images."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from semscape.app.told import Change, History
from semscape.errors import BadInputError
from semscape.io.run_folder import json_text, put_files

STATE_NAME = ".semscape-app.json"
STATE_FORMAT = 1
State = Literal["draft", "queued", "running", "done", "failed", "cancelled"]
_MOST_BYTES = 4_000_000


@dataclass(frozen=True)
class RunState:
    """How far a run is, and how it was made.

    `originals` holds the name of each file as it was called before it came here, by its stored name. `settings` are
    options as `--set` takes them. `ticket` orders the queue; `message` says why a run failed.
    """

    title: str = ""
    state: State = "draft"
    originals: Mapping[str, str] = field(default_factory=dict)
    history: History = field(default_factory=History)
    settings: tuple[str, ...] = ()
    ticket: int = 0
    message: str = ""
    edited: bool = False

    @property
    def is_busy(self) -> bool:
        """Whether the run waits or is being made, so that its images must stay as they are."""
        return self.state in ("queued", "running")


def read_state(images: Path) -> RunState:
    """Return what is remembered of the run of a folder of images; a draft where nothing can be read.

    Raises
    ------
    BadInputError
        For a file that a newer semscape wrote.
    """
    path = images / STATE_NAME
    try:
        if path.stat().st_size > _MOST_BYTES:
            return RunState(title=images.name)
        values = json.loads(path.read_bytes())
        told = values["format"]
        if isinstance(told, int) and told > STATE_FORMAT:
            raise BadInputError(f"{path.name} of {images.name} was written by a newer semscape: update semscape")
        return _state(values)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return RunState(title=images.name)


def write_state(images: Path, state: RunState) -> None:
    """Put a run's state in place, whole or not at all.

    Raises
    ------
    BadInputError
        If the folder cannot be written.
    """
    put_files({STATE_NAME: json_text({"format": STATE_FORMAT, **asdict(state)}).encode()}, images, STATE_NAME)


def _state(values: Mapping[str, Any]) -> RunState:
    state = values["state"]
    if state not in get_args(State):
        raise ValueError(f"{state!r} is no state of a run")
    done, undone = (
        tuple(Change(**change) for change in values["history"].get(which, [])) for which in ("done", "undone")
    )
    return replace(
        RunState(),
        title=str(values["title"]),
        state=state,
        originals={str(name): str(original) for name, original in values["originals"].items()},
        history=History(done, undone),
        settings=tuple(str(setting) for setting in values["settings"]),
        ticket=int(values["ticket"]),
        message=str(values["message"]),
        edited=bool(values["edited"]),
    )
