"""Where the browser is that tests and benchmarks drive, and how it is started: without a graphics card or a network."""

from __future__ import annotations

import os
import shutil

CHROMIUM_VARIABLE = "SEMSCAPE_CHROMIUM"
CHROMIUM_FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--force-color-profile=srgb",
]
_USUAL_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def find_chromium() -> str | None:
    """Return the path of a chromium: the one that the environment names, else one of the usual ones."""
    named = os.environ.get(CHROMIUM_VARIABLE)
    return named or next((path for name in _USUAL_NAMES if (path := shutil.which(name))), None)
