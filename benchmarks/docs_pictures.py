"""Draw the pictures of docs/ (`make docs-pictures`): hillshades of the measured series, the one of the README,
and the pair with a fixed threshold and a contrario.

Of a measured series two pictures are made: its hillshade, and beside each other at full size, a pixel for each height,
semscape's and that of OpenCV's StereoSGBM with the same cameras. Names given on the command line draw
those alone: potamogeton1, quartz, dsa, readme, specimens, matching, viewer,
report, coverage, full-object; viewer and report need a chromium.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from PIL.Image import fromarray

import semscape
from chromium import CHROMIUM_FLAGS, find_chromium
from full_object import all_around
from isolated import REAL_SETS, REPOSITORY, absent, real_set_folder
from semscape.dense.rival import sgbm_height_map
from semscape.experiments.matching import FIXED_THRESHOLDS_PX
from semscape.experiments.matching_pairs import simulated_pair
from semscape.experiments.study import Setting
from semscape.pipeline import reconstruct_full_object
from semscape.report.figures import hillshade_picture
from semscape.report.full_object import sides_picture
from semscape.report.hillshade import hillshade
from semscape.report.html import render_html
from semscape.report.unknown import coverage_picture
from semscape.simulate import PRESETS, SPECIMENS, acquire, simulate
from semscape.types import HeightMap, Result

if TYPE_CHECKING:
    from PIL.Image import Image
    from playwright.sync_api import Page

PICTURES = REPOSITORY / "docs" / "pictures"
_LARGEST_BYTES = 500_000
_LARGE_BYTES = 400_000
_COLOURS = 256
_GAP_PX = 8
_UNKNOWN = (200, 212, 230)
_README_SPECIMEN = "pollen"
_TILE_PX = 240
_COVERAGE_PX = 400
_FULL_OBJECT_PX = 320


def draw_real(name: str) -> dict[str, bytes]:
    """Return the pictures of a measured series, reconstructed without any option, by the names of their files."""
    result = semscape.reconstruct(semscape.load_series(real_set_folder(name)), rng=0)
    return {
        f"hillshade_{name}.png": _on_white(hillshade_picture(result.height_map)),
        f"beside_sgbm_{name}.webp": beside_sgbm(result.height_map, sgbm_height_map(result)),
    }


def beside_sgbm(ours: HeightMap, sgbm: HeightMap) -> bytes:
    """Return the hillshades of two height maps beside each other as WebP, a pixel for each height, as good as fits."""
    shades = [hillshade(each.height_um, each.pixel_size_um) for each in (ours, sgbm)]
    gap = np.full((shades[0].shape[0], _GAP_PX, 3), 255, np.uint8)
    tiles = [np.where(np.isnan(shade)[..., None], _UNKNOWN, 255 * shade[..., None]) for shade in shades]
    whole = fromarray(np.hstack([tiles[0].astype(np.uint8), gap, tiles[1].astype(np.uint8)]))
    for quality in range(90, 0, -5):
        buffer = io.BytesIO()
        whole.save(buffer, format="webp", quality=quality, method=6)
        if buffer.tell() <= _LARGEST_BYTES:
            break
    return buffer.getvalue()


def draw_readme() -> bytes:
    """Return micrograph, shaded relief and height map of a simulated series side by side."""
    return _side_by_side(_readme_result())


def draw_viewer() -> bytes:
    """Return the viewer in a browser, with a profile over the specimen."""
    with _report_in_browser() as page:
        page.click("button[data-tool=profile]")
        box = page.locator("canvas[data-name=map]").bounding_box()
        assert box is not None
        ends = [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in ((0.1, 0.62), (0.72, 0.4))]
        page.mouse.move(*ends[0])
        page.mouse.down()
        page.mouse.move(*ends[1], steps=5)
        page.mouse.up()
        page.mouse.move(5, 5)
        page.wait_for_timeout(500)
        page.wait_for_selector(".sv-root[data-picture=still]")
        return few_colours(page.locator(".sv-root").screenshot())


def draw_report() -> bytes:
    """Return the upper part of a report in a browser that prefers dark pages."""
    with _report_in_browser("dark") as page:
        page.select_option("select[aria-label='Colour by']", "micrograph")
        page.wait_for_timeout(500)
        page.wait_for_selector(".sv-root[data-picture=still]")
        page.mouse.wheel(0, -5000)
        page.wait_for_timeout(300)
        return few_colours(page.screenshot())


def few_colours(png: bytes) -> bytes:
    """Return a picture with few colours, its shades dithered: a surface in 256 plain colours has steps."""
    from PIL import Image

    with Image.open(io.BytesIO(png)) as image:
        whole = image.convert("RGB")
        few = whole.quantize(_COLOURS, kmeans=4)
        return _png(whole.quantize(palette=few, dither=Image.Dither.FLOYDSTEINBERG))


@contextmanager
def _report_in_browser(scheme: Literal["light", "dark"] = "light") -> Iterator[Page]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        path.write_text(render_html(_readme_result()), encoding="utf-8")
        browser = driver.chromium.launch(executable_path=find_chromium(), args=CHROMIUM_FLAGS)
        page = browser.new_page(viewport={"width": 1360, "height": 1000}, color_scheme=scheme)
        page.goto(path.as_uri())
        page.wait_for_selector(".sv-root[data-picture=still]")
        page.locator(".sv-views").scroll_into_view_if_needed()
        yield page
        browser.close()


@cache
def _readme_result() -> Result:
    series, _ = simulate(_README_SPECIMEN, PRESETS["nominal"], rng=0)
    return semscape.reconstruct(series, rng=0)


def draw_matching() -> bytes:
    """Return the matches of a simulated pair that a fixed threshold and the a contrario method keep."""
    from PIL import Image

    _, figure = simulated_pair(Setting(), FIXED_THRESHOLDS_PX)
    with Image.open(io.BytesIO(figure.png)) as image:
        return _png(image.resize((image.width // 2, image.height // 2), Image.Resampling.LANCZOS))


def draw_specimens() -> bytes:
    """Return the specimens of the simulated microscope side by side, and pollen by one backscatter segment."""
    options = replace(PRESETS["nominal"], tilts_deg=(0.0,), width_px=_TILE_PX, height_px=_TILE_PX, pixel_size_um=0.3)
    tiles = [simulate(name, options, rng=0)[0].views[0].image for name in SPECIMENS]
    tiles.append(acquire("pollen", replace(options, detector="bse-4"), rng=0).segments[0].views[0].image)
    rows = [np.hstack(tiles[start : start + 4]) for start in (0, 4)]
    return _png(fromarray(np.vstack(rows).astype(np.uint8)))


def draw_coverage() -> bytes:
    """Return where a simulated grain's heights are known from how many views, and why not elsewhere."""
    options = replace(PRESETS["hard"], width_px=_COVERAGE_PX, height_px=_COVERAGE_PX)
    return coverage_picture(semscape.reconstruct(simulate("pollen", options, rng=0)[0], rng=0).height_map)


def draw_full_object() -> bytes:
    """Return a simulated spiny sphere, merged from views all around, from four sides."""
    found, *_ = reconstruct_full_object(all_around(_FULL_OBJECT_PX).series, rng=0)
    return sides_picture(found.merged.mesh)


def _side_by_side(result: Result) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height_map = result.height_map
    reference = result.reconstruction.reference
    view = result.series.views[reference]
    rows, cols = height_map.height_um.shape
    extent = (0.0, cols * height_map.pixel_size_um, 0.0, rows * height_map.pixel_size_um)  # y up, as in the report
    shade = hillshade(height_map.height_um, height_map.pixel_size_um)
    low, high = np.nanpercentile(height_map.height_um, [0.2, 99.8])
    tilts = ", ".join(f"{tilt:+.1f}" for tilt in np.rad2deg(result.reconstruction.motion.tilt_rad))

    figure = Figure(figsize=(12, 4.35), dpi=75, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 3)
    panels[0].imshow(view.image, cmap="gray", extent=extent)
    panels[0].set_title(f"one of {result.series.n_views} micrographs (tilts {tilts} deg)", fontsize=9)
    panels[1].imshow(np.ma.masked_invalid(shade), cmap="gray", vmin=0, vmax=1, extent=extent)
    panels[1].set_title("the surface, lit from the upper left", fontsize=9)
    heights = panels[2].imshow(
        np.ma.masked_invalid(height_map.height_um - low), cmap="viridis", vmin=0, vmax=high - low, extent=extent
    )
    sigma = 100 * 1.96 * result.reconstruction.height_scale_relative_sigma
    panels[2].set_title(f"heights (um), height scale +-{sigma:.1f} % (95 %)", fontsize=9)
    figure.colorbar(heights, ax=panels[2], fraction=0.046, pad=0.02)
    for panel in panels:
        panel.set_facecolor("#c8d4e6")
        panel.tick_params(labelsize=8)
        panel.set_xlabel("um", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _on_white(picture: bytes) -> bytes:
    """Return a PNG on white ground, with few colours where it is a large file with all of them."""
    from PIL import Image

    with Image.open(io.BytesIO(picture)) as image:
        coloured = image.convert("RGBA")
    ground = Image.new("RGBA", coloured.size, "white")
    opaque = Image.alpha_composite(ground, coloured).convert("RGB")
    whole = _png(opaque)
    return whole if len(whole) <= _LARGE_BYTES else _png(opaque.quantize(_COLOURS, dither=Image.Dither.NONE))


def _png(image: Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()


_SIMULATED = {
    "readme": draw_readme,
    "specimens": draw_specimens,
    "matching": draw_matching,
    "viewer": draw_viewer,
    "report": draw_report,
    "coverage": draw_coverage,
    "full-object": draw_full_object,
}


def main(names: list[str]) -> None:
    """Draw the pictures that are named, or all."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names or (*REAL_SETS, *_SIMULATED):
        reason = absent(name) if name in REAL_SETS else None
        if reason:
            print(f"{name}: skipped, {reason}", file=sys.stderr)
            continue
        pictures = {f"{name}.png": _on_white(_SIMULATED[name]())} if name in _SIMULATED else draw_real(name)
        for file_name, picture in pictures.items():
            if len(picture) > _LARGEST_BYTES:
                raise SystemExit(f"{file_name} has {len(picture)} bytes, more than {_LARGEST_BYTES}")
            path = PICTURES / file_name
            path.write_bytes(picture)
            print(f"{path.relative_to(REPOSITORY)}: {len(picture) // 1000} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
