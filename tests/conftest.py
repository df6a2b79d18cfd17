"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SHARED_DATA_VARIABLE = "SEMSCAPE_SHARED_DATA"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data by others, which is no part of the repository; skips where it is absent."""
    beside_repository = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get(SHARED_DATA_VARIABLE, beside_repository))
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; set {SHARED_DATA_VARIABLE} to the folder that holds it")
    return folder
