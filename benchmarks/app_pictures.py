"""Photograph the app with a simulated specimen for docs/app.md (`make docs-pictures`); needs chromium."""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from app_server import served
from chromium import CHROMIUM_FLAGS, find_chromium
from isolated import REPOSITORY
from semscape.io.simulated import write_simulated_series
from semscape.simulate import PRESETS, simulate

PICTURES = REPOSITORY / "docs" / "pictures"
_COLOURS = 256
_RUN_MS = 300_000


def main() -> None:
    """Take the pictures app-table, app-progress and app-result."""
    chromium = find_chromium()
    if chromium is None:
        print("pictures of the app: skipped, there is no chromium", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        images = write_simulated_series(Path(folder) / "images", *simulate("pollen", PRESETS["nominal"], rng=0))
        browser = playwright.chromium.launch(executable_path=chromium, args=CHROMIUM_FLAGS)
        with served(Path(folder) / "semscape-runs") as (_, address):
            page = browser.new_page(viewport={"width": 1200, "height": 860})
            page.goto(address)
            _photograph(page, sorted(images.glob("*.tif")))
        browser.close()


def _photograph(page: Page, images: list[Path]) -> None:
    page.on("dialog", lambda dialog: dialog.accept("Pollen, 5 kV"))
    page.set_input_files("input[type=file]:not([webkitdirectory])", images)
    page.wait_for_selector("tbody tr")
    page.get_by_role("button", name="Rename").click()
    page.get_by_role("heading", name="Pollen, 5 kV").wait_for()
    while not page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth)"):
        page.wait_for_timeout(100)
    _keep(page, "app-table")
    page.get_by_role("button", name="Reconstruct", exact=True).click()
    page.wait_for_selector("canvas.preview", timeout=_RUN_MS)
    _keep(page, "app-progress")
    page.wait_for_selector(".sv-root canvas", timeout=_RUN_MS)
    page.set_viewport_size({"width": 1200, "height": 1120})
    page.wait_for_timeout(2000)  # the full resolution comes when the view is still
    _keep(page, "app-result")


def _keep(page: Page, name: str) -> None:
    with Image.open(io.BytesIO(page.screenshot())) as shot:
        few = shot.convert("RGB").quantize(_COLOURS, dither=Image.Dither.FLOYDSTEINBERG)
    path = PICTURES / f"{name}.png"
    few.save(path, optimize=True)
    print(f"{path.relative_to(REPOSITORY)}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
