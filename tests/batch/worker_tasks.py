"""Tasks that a worker process imports by name."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from semscape.cluster import tell


def square(x: int) -> int:
    if x < 0:
        raise ValueError(f"{x} is negative")
    return x * x


def nothing(_: int) -> None:
    return None


def add(_: bytes, item: bytes) -> bytes:
    return item


def thread_limits(_: int) -> list[str | None]:
    return [os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")]


def die_once(marker: str) -> int:
    """Kill this process, but not if it has been killed for this marker before."""
    tell("surface")
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die(_: int) -> None:
    tell("surface")
    os.kill(os.getpid(), signal.SIGKILL)


def crash(_: int) -> None:
    os.kill(os.getpid(), signal.SIGABRT)


def sleep(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def fill(n_bytes: int) -> int:
    """Hold so many bytes for a while: memory is watched from outside, some times a second."""
    tell("surface")
    held = np.ones(n_bytes, np.uint8)
    if n_bytes > 1_000_000:
        time.sleep(1.0)
    return len(held)


def complain(_: int) -> None:
    print("a library's complaint", file=sys.stderr)  # noqa: T201
