"""What a lack of memory looks like, and what to reduce against it."""

from __future__ import annotations

import errno

from semscape.errors import OutOfMemoryError

_REDUCE = {
    "load": "fewer or smaller images",
    "detect": "--set features.max_keypoints=10000, or smaller images",
    "match": "--set features.max_keypoints=10000",
    "calibrate": "--set features.max_keypoints=10000",
    "surface": "--set dense.tile_px=512, or smaller images",
    "mesh": "--set dense.mesh_max_vertices=100000",
    "report": "--set dense.mesh_max_vertices=100000",
}


def lack_of_memory(error: Exception, stage: str) -> OutOfMemoryError | None:
    """Return what to say of an error that is a lack of memory, in the words of any library; None for every other."""
    if not _is_lack(error):
        return None
    less = _REDUCE.get(stage, "smaller images")
    return OutOfMemoryError(f"out of memory in stage {stage}; fewer --workers, more --memory-mb, or {less}")


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
