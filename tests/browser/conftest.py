"""A real browser: Debian's chromium, or the one that SEMSCAPE_CHROMIUM names."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

CHROMIUM_VARIABLE = "SEMSCAPE_CHROMIUM"
USUAL_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# Software GL: the same pictures with and without a graphics card.
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SCREENSHOTS = Path(__file__).resolve().parents[2] / "build" / "screenshots"


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Start chromium once for all tests; skip where there is none."""
    found = os.environ.get(CHROMIUM_VARIABLE) or next(filter(None, map(shutil.which, USUAL_NAMES)), None)
    if found is None:
        pytest.skip(f"no chromium (Debian: apt install chromium); {CHROMIUM_VARIABLE} may name one")
    with sync_playwright() as playwright:
        expect.set_options(timeout=30_000)  # a machine may be busy
        started = playwright.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """Give a fresh window of 1280 x 900 px."""
    made = browser.new_context(viewport={"width": 1280, "height": 900}, accept_downloads=True)
    made.set_default_timeout(30_000)
    yield made
    made.close()


@pytest.fixture
def shoot() -> Callable[[Page, str], None]:
    """Keep a picture of a page among the artefacts of the tests."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)

    def keep(page: Page, name: str) -> None:
        page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)

    return keep
