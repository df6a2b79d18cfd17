"""What a lack of memory looks like, and what to reduce against it."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from semscape.errors import OutOfMemoryError

Progress = Callable[[str, dict[str, Any] | None], None]

_REDUCE = {
    "load": "fewer or smaller images",
    "detect": "--set features.max_keypoints=10000, or smaller images",
    "match": "--set features.max_keypoints=10000",
    "calibrate": "--set features.max_keypoints=10000",
    "surface": "--set dense.tile_px=512, or smaller images",
    "mesh": "--set dense.mesh_max_vertices=100000",
    "report": "--set dense.mesh_max_vertices=100000",
}


@contextmanager
def lack_of_memory_told(progress: Progress | None) -> Iterator[Progress]:
    """Turn what is a lack of memory, in the words of any library, into one message with the stage and what to reduce.

    Yields what is to be told of the stages in place of `progress`, which is told of them in turn.

    Raises
    ------
    OutOfMemoryError
        Instead of `MemoryError` and its like; every other error passes.
    """
    stage = "load"

    def follow(name: str, figures: dict[str, Any] | None) -> None:
        nonlocal stage
        if figures is None:
            stage = name
        if progress:
            progress(name, figures)

    try:
        yield follow
    except Exception as error:
        if not _is_lack(error):
            raise
        less = _REDUCE.get(stage, "smaller images")
        raise OutOfMemoryError(
            f"out of memory in stage {stage}; fewer --workers, more --memory-mb, or {less}"
        ) from error


def _is_lack(error: BaseException | None) -> bool:
    if error is None:
        return False
    told = str(error)
    return (
        isinstance(error, MemoryError)
        or (isinstance(error, OSError) and error.errno == errno.ENOMEM)
        or (isinstance(error, ImportError) and ("failed to map" in told or "annot allocate memory" in told))
        or (isinstance(error, RuntimeError) and "can't start new thread" in told)
        or (type(error).__name__ == "error" and "nsufficient memory" in told)  # OpenCV's own class
        or _is_lack(error.__cause__)
    )
