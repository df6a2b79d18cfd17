"""The digest of the code that makes results: what it changes with, stored results must not outlive."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from functools import cache
from pathlib import Path

_NUMERICAL = ("numpy", "scipy", "opencv-contrib-python-headless", "numba", "mahotas", "tifffile", "imagecodecs")


@cache
def code_digest() -> str:
    """Return the SHA-256 over semscape's source files and the versions of the packages that decide the numbers."""
    digest = hashlib.sha256(platform.python_version().encode())
    for package in _NUMERICAL:
        try:
            digest.update(f"{package} {importlib.metadata.version(package)}\n".encode())
        except importlib.metadata.PackageNotFoundError:
            digest.update(f"{package} unknown\n".encode())
    root = Path(__file__).parent.parent
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
