"""The app as a user starts it: a process of its own, and the address that it prints."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2

WAIT_S = 120


def app_command(workspace: Path) -> list[str]:
    return [sys.executable, "-m", "semscape", "app", "--no-browser", "--workspace", str(workspace)]


def app_environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


@contextmanager
def served(workspace: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Serve a workspace; give the process and the address to open."""
    process = subprocess.Popen(app_command(workspace), env=app_environment(), stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
        until = time.monotonic() + WAIT_S
        while True:
            try:
                httpx2.get(address)
                break
            except httpx2.TransportError:
                assert time.monotonic() < until
                time.sleep(0.05)
        yield process, address
    finally:
        process.terminate()
        process.communicate(timeout=30)


@contextmanager
def opened(address: str) -> Iterator[httpx2.Client]:
    """Give a client that has opened the address, as a browser would."""
    origin = address.partition("/?")[0]
    with httpx2.Client(base_url=origin, headers={"Origin": origin}, timeout=60) as client:
        assert client.get(address).status_code == 303
        yield client
