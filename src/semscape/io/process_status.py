"""What Linux tells of the memory of a process."""

from __future__ import annotations

import math
import re
from pathlib import Path


def status_mb(key: str, process: int | None = None) -> float:
    """Return a figure of a process's status in MB, like VmHWM (peak) or VmRSS (held now).

    Parameters
    ----------
    key : str
        Name of the figure, as Linux has it.
    process : int, optional
        Number of the process; this one where left out.

    Returns
    -------
    float
        NaN where none is told: by other systems, or because the process has ended.

    Examples
    --------
    >>> status_mb("VmNothing")
    nan
    """
    try:
        text = Path(f"/proc/{process or 'self'}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return math.nan
    found = re.search(rf"^{key}:\s*(\d+) kB", text, re.MULTILINE)
    return int(found[1]) * 1.024e-3 if found else math.nan
