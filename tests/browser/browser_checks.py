"""Checks of a page that several tests make, and the pictures that they keep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# Pictures of every page that a test has used: artefacts to look at.
SCREENSHOTS = Path(__file__).resolve().parents[2] / "build" / "screenshots"
_SERIOUS = {"serious", "critical"}


def keep_picture(page: Any, name: str, *, whole: bool = False) -> None:
    """Keep a picture of what a page shows, or of the whole page, in `build/screenshots`."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    plain = "".join(letter if letter.isalnum() else "-" for letter in name).strip("-")
    page.screenshot(path=SCREENSHOTS / f"{plain}.png", full_page=whole)


def serious_faults(page: Any, axe_script: str) -> list[str]:
    """Return what axe finds of serious faults in a page: rule, and the first elements that break it."""
    page.evaluate(axe_script)  # a page's policy forbids another script element
    found = page.evaluate("async () => (await axe.run(document, {resultTypes: ['violations']})).violations")
    return [
        f"{fault['id']}: {[node['html'][:160] for node in fault['nodes'][:3]]}"
        for fault in found
        if fault["impact"] in _SERIOUS
    ]
