"""The viewer in headless Chromium with software GL: seconds to the first picture and to the full one, bytes, as JSON.

`python benchmarks/viewer.py 1024 4096` takes sizes of square maps; 1024 and 4096 where none are named. Between its
pictures an empty page is opened on which three.js draws one triangle, in a canvas of the size of the viewer's: what a
busy machine does to a time it does to both, so that their ratio tells more. The load is that of the last minute.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright
from scipy import ndimage

from chromium import CHROMIUM_FLAGS, find_chromium
from isolated import REPOSITORY
from semscape.report.markup import page
from semscape.report.surface_file import encode_surface
from semscape.report.viewer_page import viewer_script
from semscape.types import HeightMap

_ROUNDS = 3
_DEADLINE_MS = 300_000
_SIZE = {"width": 1440, "height": 1000}
_WEB = REPOSITORY / "web"
_EMPTY = """
import { BufferAttribute, BufferGeometry, Camera, Mesh, MeshBasicMaterial, Scene, WebGLRenderer } from "three";
const root = document.createElement("div");
root.className = "sv-root";
const renderer = new WebGLRenderer({ alpha: true });
renderer.setSize(640, 560);
root.append(renderer.domElement);
document.body.append(root);
const geometry = new BufferGeometry();
geometry.setAttribute("position", new BufferAttribute(new Float32Array([-0.5, -0.5, 0, 0.5, -0.5, 0, 0, 0.5, 0]), 3));
const scene = new Scene().add(new Mesh(geometry, new MeshBasicMaterial()));
requestAnimationFrame(() => {
  renderer.render(scene, new Camera());
  requestAnimationFrame(() => requestAnimationFrame(() => (root.dataset.ready = "true")));
});
"""


def rough_map(size: int) -> HeightMap:
    """Return a surface like a measured one: waves, roughness, noise of the matching, holes, a noisy micrograph."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:size, :size] * (25.0 / 1024)
    height = 3 * np.sin(x) * np.cos(y) + ndimage.gaussian_filter(rng.normal(size=(size, size)), 2) * 0.5
    holes = ndimage.gaussian_filter(rng.normal(size=(size, size)), 6) > 0.1
    height[holes] = np.nan
    sigma = 0.1 * np.exp(ndimage.gaussian_filter(rng.normal(size=(size, size)), 3) * 4)
    return HeightMap(
        height,
        np.where(holes, np.nan, sigma),
        rng.integers(2, 6, (size, size)).astype(np.uint8),
        rng.normal(128, 30, (size, size)).astype(np.float32),
        0.1,
        np.diag([0.1, -0.1, 1.0, 1.0]),
        "um",
    )


def empty_page(folder: Path) -> Path | None:
    """Return a page on which three.js draws one triangle; None where three.js or Node is not there."""
    node, esbuild = shutil.which("node"), _WEB / "node_modules" / "esbuild" / "bin" / "esbuild"
    if node is None or not esbuild.is_file():
        return None
    bundled = subprocess.run(
        [node, str(esbuild), "--bundle", "--minify", "--format=iife", "--target=es2022"],
        input=_EMPTY,
        capture_output=True,
        text=True,
        cwd=_WEB,
        check=True,
    )
    path = folder / "empty.html"
    path.write_text(page("empty", [], bundled.stdout), encoding="utf-8")
    return path


def first_picture_s(browser: Browser, path: Path) -> tuple[Page, float, float]:
    """Return a page, when its opening began, and the seconds to its first picture."""
    opened = browser.new_page(viewport=_SIZE)  # type: ignore[arg-type]
    opened.set_default_timeout(_DEADLINE_MS)
    start = time.perf_counter()
    opened.goto(path.as_uri())
    opened.wait_for_selector(".sv-root[data-ready=true]")
    return opened, start, time.perf_counter() - start


def measure(browser: Browser, size: int, folder: Path) -> dict[str, Any]:
    """Return what a map of size x size heights takes in a page that carries all of it, as a report does."""
    script = viewer_script()
    if script is None:
        raise SystemExit("the viewer is not bundled: `make web` does it")
    start = time.perf_counter()
    content = encode_surface(rough_map(size))
    encode_s = time.perf_counter() - start
    carried = base64.b64encode(content).decode("ascii")
    place = '<div id="semscape-viewer"></div>'
    data = f'<script type="application/octet-stream" id="semscape-surface">{carried}</script>'
    path = folder / f"{size}.html"
    path.write_text(page("benchmark", [place, data], script), encoding="utf-8")
    first, still, empty, heap = [], [], [], 0
    beside = empty_page(folder)
    for _ in range(_ROUNDS):
        if beside is not None:
            opened, _, seconds = first_picture_s(browser, beside)
            empty.append(seconds)
            opened.close()
        opened, start, seconds = first_picture_s(browser, path)
        first.append(seconds)
        opened.wait_for_selector(".sv-root[data-picture=still]")
        still.append(time.perf_counter() - start)
        heap = opened.evaluate("performance.memory.usedJSHeapSize")
        triangles = int(opened.get_attribute(".sv-root", "data-triangles") or 0)
        opened.close()
    return {
        "size": size,
        "surface_bytes": len(content),
        "page_bytes": path.stat().st_size,
        "make_surface_s": round(encode_s, 2),
        "load": round(os.getloadavg()[0], 1),
        "first_picture_s": [round(seconds, 2) for seconds in first],
        "empty_three_js_page_s": [round(seconds, 2) for seconds in empty],
        "first_picture_of_empty_page": round(statistics.median(first) / statistics.median(empty), 1) if empty else None,
        "full_picture_s": [round(seconds, 2) for seconds in still],
        "full_picture_triangles": triangles,
        "script_heap_mb": round(heap / 1e6),
    }


def main(sizes: list[int]) -> None:
    """Print one object for each size."""
    path = find_chromium()
    if path is None:
        raise SystemExit("no chromium: install Debian's package of that name, or set SEMSCAPE_CHROMIUM to its program")
    with sync_playwright() as driver, tempfile.TemporaryDirectory() as folder:
        browser = driver.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        print(json.dumps([measure(browser, size, Path(folder)) for size in sizes], indent=2))
        browser.close()


if __name__ == "__main__":
    main([int(size) for size in sys.argv[1:]] or [1024, 4096])
