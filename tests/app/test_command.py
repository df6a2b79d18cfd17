"""`semscape app` where it cannot serve."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from semscape.app import pages
from semscape.app.command import run_app
from semscape.errors import BadInputError


def start(folder: Path) -> None:
    run_app(folder, None, open_browser=False, say=lambda _: None)


def test_without_the_extra_it_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(BadInputError, match=r"needs uvicorn.*pip install 'semscape\[app\]'"):
        start(tmp_path)


def test_without_its_pages_it_says_how_to_make_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages.resources, "files", lambda _: tmp_path)
    with pytest.raises(BadInputError, match="make web"):
        start(tmp_path)


def test_a_workspace_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("text")
    with pytest.raises(BadInputError, match="cannot be made"):
        start(tmp_path / "file")
