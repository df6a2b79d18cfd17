"""The most memory that this process has held: in all, and since a moment."""

from __future__ import annotations

import ctypes
import math
import sys
from pathlib import Path

from semscape.io.process_status import status_mb

_CLEAR = Path("/proc/self/clear_refs")
_RESET_PEAK = "5"
_highest_mb = 0.0


class PeakMemory:
    """The most memory since this object was made; on Linux alone, where the system's mark can be set back."""

    def __init__(self) -> None:
        global _highest_mb
        _highest_mb = peak_memory_mb()  # before the mark goes
        try:
            _CLEAR.write_text(_RESET_PEAK)
            self._known = True
        except OSError:
            self._known = False

    def peak_mb(self) -> float:
        """Return the peak in MB; NaN where the system does not tell."""
        return status_mb("VmHWM") if self._known else math.nan


def peak_memory_mb() -> float:
    """Return the most memory that this process has held so far, in MB; NaN where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(_highest_mb, peak / (1e6 if sys.platform == "darwin" else 1e3))


def release_memory() -> None:
    """Give the memory that is free back to the system, which the C library of Linux keeps for later in large parts."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)
