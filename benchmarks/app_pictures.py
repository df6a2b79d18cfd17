"""Photograph the app with a simulated specimen for docs/app.md (`make docs-pictures`); needs chromium."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from app_server import served
from chromium import CHROMIUM_FLAGS, find_chromium
from docs_pictures import few_colours
from isolated import REPOSITORY
from semscape.io.simulated import write_simulated_series
from semscape.simulate import PRESETS, simulate

PICTURES = REPOSITORY / "docs" / "pictures"
_RUN_MS = 600_000
# Corners of a polygon around the pollen grain, as shares of the map's view.
_AROUND = [
    (0.3, 0.27),
    (0.45, 0.25),
    (0.59, 0.33),
    (0.66, 0.5),
    (0.6, 0.66),
    (0.45, 0.73),
    (0.28, 0.71),
    (0.19, 0.6),
    (0.2, 0.4),
]


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
    page.wait_for_function("[...document.images].every(image => image.complete && image.naturalWidth)")
    _keep(page, "app-table")
    page.get_by_role("button", name="Reconstruct", exact=True).click()
    page.wait_for_selector("canvas.preview", timeout=_RUN_MS)
    _keep(page, "app-progress")
    page.wait_for_selector(".sv-root canvas", timeout=_RUN_MS)
    page.set_viewport_size({"width": 1200, "height": 1240})
    page.click("[data-tool=region]")
    page.click("button:has-text('Polygon')")
    box = page.locator("canvas[data-name=map]").bounding_box()
    assert box is not None
    for x, y in [*_AROUND, _AROUND[0]]:
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    page.mouse.move(5, 5)
    page.wait_for_selector(".sv-root[data-picture=still]")
    _keep(page, "app-result")


def _keep(page: Page, name: str) -> None:
    path = PICTURES / f"{name}.png"
    path.write_bytes(few_colours(page.screenshot()))
    print(f"{path.relative_to(REPOSITORY)}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
