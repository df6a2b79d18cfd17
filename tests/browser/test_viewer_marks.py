"""Marking regions as a hand does it: with the pointer on map and surface, and with the keyboard alone."""

from __future__ import annotations

import base64
from typing import Any

import pytest

from semscape.report.surface_file import encode_surface
from synthetic_result import make_result

CONTENT = encode_surface(make_result(size=(96, 128)).height_map)
CORNERS = [(30, 20), (100, 30), (80, 80), (40, 70)]


@pytest.fixture
def drawing(page: Any, viewer_bundle: str) -> Any:
    """Return a page with the viewer, that is about to draw a polygon for an area."""
    page.set_content("<!DOCTYPE html><html lang='en'><title>t</title><body style='margin:0'></body></html>")
    page.evaluate(viewer_bundle.replace("var viewer =", "window.viewer =", 1))
    page.evaluate(
        """async (content) => {
          const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
          window.handle = viewer.mountViewer(document.body, await viewer.decodeSurface(bytes.buffer));
          await window.handle.firstPicture;
        }""",
        base64.b64encode(CONTENT).decode(),
    )
    page.click("[data-tool=region]")
    page.click("button:has-text('Polygon')")
    return page


def marks(page: Any) -> tuple[list[tuple[int, int]], list[int]]:
    kept = page.evaluate("window.handle.state().marks")
    return [(place["x"], place["y"]) for place in kept["places"]], kept["ends"]


def on_map(page: Any, x: float, y: float) -> tuple[float, float]:
    """Return where a height of the map is on the page; the map is centred beside its colour bar."""
    box = page.locator("canvas[data-name=map]").bounding_box()
    width = box["width"] - 88
    scale = min((width - 24) / 128, (box["height"] - 24) / 96)
    return box["x"] + width / 2 + (x - 63.5) * scale, box["y"] + box["height"] / 2 + (y - 47.5) * scale


def test_clicks_make_a_polygon_that_its_first_corner_closes(drawing: Any) -> None:
    for corner in CORNERS:
        drawing.mouse.click(*on_map(drawing, *corner))
        assert drawing.locator(".sv-table").count() == 0
    assert marks(drawing) == (CORNERS, [])
    assert drawing.is_visible("text=Close polygon")
    drawing.mouse.click(*on_map(drawing, *CORNERS[0]))
    assert marks(drawing) == (CORNERS, [4])
    assert drawing.locator(".sv-table tr[data-name='Developed area']").count() == 1
    assert not drawing.is_visible("text=Close polygon")


def test_a_double_click_closes_a_polygon_at_its_last_corner(drawing: Any) -> None:
    for corner in CORNERS[:-1]:
        drawing.mouse.click(*on_map(drawing, *corner))
    drawing.mouse.dblclick(*on_map(drawing, *CORNERS[-1]))
    assert marks(drawing) == (CORNERS, [4])


def test_corners_can_be_dragged_and_taken_back(drawing: Any) -> None:
    for corner in CORNERS:
        drawing.mouse.click(*on_map(drawing, *corner))
    drawing.click("text=Close polygon")
    before = drawing.get_attribute(".sv-table tr[data-name='Projected area']", "data-value")
    drawing.mouse.move(*on_map(drawing, *CORNERS[2]))
    drawing.mouse.down()
    drawing.mouse.move(*on_map(drawing, 90, 88), steps=3)
    drawing.mouse.up()
    assert marks(drawing) == ([*CORNERS[:2], (90, 88), CORNERS[3]], [4])
    assert drawing.get_attribute(".sv-table tr[data-name='Projected area']", "data-value") != before
    drawing.keyboard.press("Backspace")
    assert marks(drawing)[1] == []
    drawing.keyboard.press("Backspace")
    assert len(marks(drawing)[0]) == 3


def test_the_keyboard_alone_draws_a_polygon_and_escape_cancels(drawing: Any) -> None:
    drawing.click("[data-tool=step]")
    drawing.locator("canvas[data-name=map]").focus()

    def press(*keys: str) -> None:
        for key in keys:
            drawing.keyboard.press(key)

    right, down, up = ["Shift+ArrowRight"] * 2, ["Shift+ArrowDown"] * 2, ["Shift+ArrowUp"] * 2
    press("ArrowLeft", "Enter", *right, "Enter", *down, "Enter", "Enter")
    first = [(63, 47), (83, 47), (83, 67)]
    assert marks(drawing) == (first, [3])
    press(*up, *up, "Enter", *right, "Enter")
    assert len(marks(drawing)[0]) == 5
    press("Escape")
    assert marks(drawing) == (first, [3])  # the region that was drawn before stays
    press("Enter", *right, "Enter", *up, "Enter", "Enter")
    assert marks(drawing)[1] == [3, 6]
    assert drawing.locator(".sv-table tr[data-name='Step height']").count() == 1
    press("Escape")
    assert marks(drawing) == ([], [])


def test_a_polygon_is_drawn_on_the_surface_in_3d_too(drawing: Any) -> None:
    drawing.click("button:has-text('Top')")
    drawing.wait_for_selector(".sv-root[data-picture=still]")
    box = drawing.locator("canvas[data-name=surface]").bounding_box()
    middle = box["x"] + box["width"] / 2 - 44, box["y"] + box["height"] / 2
    corners = [(middle[0] + dx, middle[1] + dy) for dx, dy in [(-60, -50), (60, -50), (10, 60)]]
    for corner in [*corners, corners[0]]:
        drawing.mouse.click(*corner)
    assert marks(drawing)[1] == [3]
    assert drawing.locator(".sv-table tr[data-name='Volume above']").count() == 1


def test_a_rectangle_that_was_begun_is_no_corner_of_a_polygon(drawing: Any) -> None:
    drawing.click("button:has-text('Rectangle')")
    drawing.mouse.click(*on_map(drawing, 30, 20))
    drawing.click("button:has-text('Polygon')")
    assert marks(drawing) == ([], [])
    drawing.click("button:has-text('Rectangle')")
    drawing.mouse.move(*on_map(drawing, 30, 20))
    drawing.mouse.down()
    drawing.mouse.move(*on_map(drawing, 90, 60), steps=3)
    drawing.mouse.up()
    assert marks(drawing) == ([(30, 20), (90, 60)], [2])
