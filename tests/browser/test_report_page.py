"""The report in a real browser: it opens by itself, shows the surface, and asks nobody for anything."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_checks import SCREENSHOTS, keep_picture, serious_faults
from PIL import Image

from semscape.report import render_html
from semscape.report.viewer_page import viewer_script
from synthetic_result import make_result

RESULT = make_result(size=(96, 128))


@pytest.fixture(scope="session")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if viewer_script() is None:
        pytest.skip("the viewer is not bundled: `make web` does it")
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(render_html(RESULT), encoding="utf-8")
    return path


@pytest.fixture
def opened(page: Any, report: Path) -> Any:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(report.as_uri())
    page.wait_for_selector(".sv-root[data-picture=still]")
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [report.as_uri()]
    return page


def box_of(page: Any, name: str) -> dict[str, float]:
    canvas = page.locator(f"canvas[data-name={name}]")
    canvas.scroll_into_view_if_needed()
    box: dict[str, float] = canvas.bounding_box()
    return box


def shown(page: Any, name: str) -> np.ndarray:
    """Return the middle of a view as pixels."""
    box = box_of(page, name)
    inner = {"x": box["x"] + 60, "y": box["y"] + 40, "width": box["width"] - 220, "height": box["height"] - 120}
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=inner))).convert("RGB"))


@pytest.mark.parametrize("name", ["surface", "map"])
def test_the_surface_is_seen(opened: Any, name: str) -> None:
    colours = shown(opened, name).reshape(-1, 3)
    assert len(np.unique(colours, axis=0)) > 500
    strong = np.ptp(colours.astype(int), axis=1) > 60  # viridis, which the grey ground is not
    assert strong.mean() > 0.1


def test_what_is_read_at_the_cursor_is_the_height_map(opened: Any) -> None:
    box = box_of(opened, "map")
    read = 0
    for share_x, share_y in ((0.3, 0.45), (0.45, 0.6), (0.6, 0.4)):
        opened.mouse.move(box["x"] + share_x * box["width"], box["y"] + share_y * box["height"])
        told = opened.inner_text(".sv-readout").replace("−", "-")
        col, row = (int(part) for part in re.search(r"px (\d+), (\d+)", told).groups())
        x, y, z, sigma = (
            float(re.search(pattern, told)[1]) for pattern in (r"x (\S+)", r"y (\S+)", r"z (\S+)", r"± (\S+)")
        )
        height, uncertainty = RESULT.height_map.height_um[row, col], RESULT.height_map.uncertainty_um[row, col]
        world = RESULT.height_map.world_from_grid @ [col, row, height, 1]
        assert [x, y] == pytest.approx(world[:2], abs=0.01)
        assert z == pytest.approx(world[2], abs=0.1 * uncertainty)
        assert sigma == pytest.approx(uncertainty, rel=0.06)
        read += 1
    assert read == 3


def test_the_cursor_in_3d_points_at_the_same_place_in_the_map(opened: Any) -> None:
    before = shown(opened, "map")
    box = box_of(opened, "surface")
    opened.mouse.move(box["x"] + 0.42 * box["width"], box["y"] + 0.5 * box["height"])
    assert "px" in opened.inner_text(".sv-readout")
    assert (shown(opened, "map") != before).any()


def test_every_control_is_reached_by_keyboard(opened: Any) -> None:
    opened.locator("select[aria-label='Colour by']").focus()
    reached = set()
    for _ in range(60):
        opened.keyboard.press("Tab")
        reached.add(
            opened.evaluate(
                "(e => e.getAttribute('aria-label') || e.dataset?.tool || e.textContent.trim())(document.activeElement)"
            )
        )
    wanted = {"Colour map", "Wireframe", "Orthographic", "Light", "Show", "Save", "profile", "step", "texture"}
    assert wanted | {"Surface in three dimensions", "Height map from above"} <= reached


def test_a_line_by_keyboard_makes_a_profile(opened: Any) -> None:
    opened.click("[data-tool=profile]")
    opened.locator("canvas[data-name=map]").focus()
    for key in ["ArrowLeft", *["Shift+ArrowLeft"] * 3, "Enter", *["Shift+ArrowRight"] * 5, "Enter"]:
        opened.keyboard.press(key)
    names = opened.eval_on_selector_all(".sv-table tr", "rows => rows.map(row => row.dataset.name)")
    assert {"Ra", "Rq", "Pq"} <= set(names)
    assert opened.locator(".sv-plot-curve").count() == 1
    with opened.expect_download() as saving:
        opened.click("text=Save profile (CSV)")
    lines = Path(saving.value.path()).read_text(encoding="utf-8").split()
    assert lines[0] == "distance_um,height_um,sigma_um"
    assert len(lines) == 52  # 50 px, ends included, and the head


def test_arrow_keys_turn_the_surface(opened: Any) -> None:
    before = shown(opened, "surface")
    opened.locator("canvas[data-name=surface]").focus()
    for _ in range(4):
        opened.keyboard.press("ArrowLeft")
    opened.wait_for_timeout(400)
    opened.wait_for_selector(".sv-root[data-picture=still]")
    assert (shown(opened, "surface") != before).mean() > 0.1


def test_nothing_is_drawn_while_nothing_changes(opened: Any) -> None:
    opened.mouse.move(5, 5)
    opened.wait_for_timeout(300)
    count = opened.get_attribute(".sv-root", "data-pictures")
    opened.wait_for_timeout(700)
    assert opened.get_attribute(".sv-root", "data-pictures") == count


def test_a_picture_is_saved(opened: Any) -> None:
    opened.click("summary:has-text('Save')")
    with opened.expect_download() as saving:
        opened.click("text=Picture of the view")
    picture = np.asarray(Image.open(saving.value.path()).convert("RGB")).reshape(-1, 3)
    assert len(np.unique(picture, axis=0)) > 500


def test_paper_gets_pictures_instead_of_the_viewer(opened: Any) -> None:
    assert not opened.is_visible("img[alt='Height map']")
    opened.emulate_media(media="print")
    assert opened.is_visible("img[alt='Height map']")
    assert not opened.is_visible(".sv-root")
    keep_picture(opened, "report-print", whole=True)
    pdf = opened.pdf(format="A4", path=SCREENSHOTS / "report.pdf")
    assert pdf.startswith(b"%PDF")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_serious_fault(page: Any, report: Path, axe: str, scheme: str) -> None:
    page.emulate_media(color_scheme=scheme)
    page.goto(report.as_uri())
    page.wait_for_selector(".sv-root[data-ready=true]")
    page.click("[data-tool=texture]")
    page.click("summary:has-text('Show')")
    assert serious_faults(page, axe) == []
    keep_picture(page, f"report-{scheme}", whole=True)


def test_it_reads_at_twice_the_size(browser: Any, report: Path) -> None:
    page = browser.new_page(viewport={"width": 640, "height": 480}, device_scale_factor=2)
    page.goto(report.as_uri())
    page.wait_for_selector(".sv-root[data-ready=true]")
    assert page.evaluate("document.documentElement.scrollWidth") <= 640
    keep_picture(page, "report-200-percent", whole=True)
    page.close()


def test_without_webgl_map_and_tools_go_on(page: Any, report: Path) -> None:
    page.add_init_script(
        "const real = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {"
        "  return kind.startsWith('webgl') ? null : real.call(this, kind, ...rest); };"
    )
    page.goto(report.as_uri())
    page.wait_for_selector(".sv-root[data-ready=true]")
    assert "WebGL 2" in page.inner_text(".sv-message")
    assert len(np.unique(shown(page, "map").reshape(-1, 3), axis=0)) > 500
    page.click("[data-tool=texture]")
    assert page.locator(".sv-table tr[data-name=Sq]").count() == 1


def test_without_scripts_there_are_pictures(browser: Any, report: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.is_visible("img[alt='Height map']")
    keep_picture(page, "report-without-scripts", whole=True)
    context.close()


def test_a_notebook_shows_the_viewer(page: Any) -> None:
    page.set_content(f"<!DOCTYPE html><html lang='en'><body>{RESULT._repr_html_()}</body></html>")
    frame = page.frame_locator("iframe")
    frame.locator(".sv-root[data-picture=still]").wait_for()
    assert frame.locator(".sv-readout").inner_text().startswith("128 × 96 heights")
