"""A real browser for pages: Debian's chromium, or the one that SEMSCAPE_CHROMIUM names, driven by Playwright."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser_checks import keep_picture

from chromium import CHROMIUM_FLAGS, CHROMIUM_VARIABLE, find_chromium

WEB = Path(__file__).resolve().parents[2] / "web"


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Start the browser once; skips, with the reason, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
    path = find_chromium()
    if path is None:
        pytest.skip(f"no chromium: install Debian's package of that name, or set {CHROMIUM_VARIABLE} to its program")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        yield started
        started.close()


@pytest.fixture
def page(browser: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    """Return an empty page that fails the test when its scripts do; a picture of it is kept at the end."""
    opened = browser.new_page(viewport={"width": 1280, "height": 1000})
    faults: list[str] = []
    opened.on("pageerror", lambda error: faults.append(str(error)))
    opened.on("console", lambda said: faults.append(said.text) if _is_fault(said) else None)
    opened.set_default_timeout(60_000)
    yield opened
    keep_picture(opened, request.node.name.removeprefix("test_"))
    opened.close()
    assert not faults


def _is_fault(said: Any) -> bool:
    # three.js reports a missing WebGL as an error before the viewer says what to do.
    return said.type == "error" and "creating WebGL context" not in said.text


@pytest.fixture(scope="session")
def viewer_bundle(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the viewer as a script that names its functions, which the report's own bundle does not."""
    esbuild = WEB / "node_modules" / "esbuild" / "bin" / "esbuild"
    node = shutil.which("node")
    if node is None or not esbuild.is_file():
        pytest.skip("the viewer's sources cannot be bundled here: no node, or no web/node_modules (make web-check)")
    output = tmp_path_factory.mktemp("bundle") / "viewer.js"
    options = ["--bundle", "--format=iife", "--global-name=viewer", "--loader:.css=text", "--target=es2022"]
    entry = str(WEB / "src" / "viewer" / "index.ts")
    subprocess.run([node, str(esbuild), entry, *options, f"--outfile={output}"], check=True, capture_output=True)
    return output.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def axe() -> str:
    """Return axe-core's script, the check of accessibility."""
    path = WEB / "node_modules" / "axe-core" / "axe.min.js"
    if not path.is_file():
        pytest.skip("no axe-core in web/node_modules: `make web-check` installs it")
    return path.read_text(encoding="utf-8")
