"""The viewer's tools against semscape.metrology, on the same heights; what it draws, and how much of it."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semscape.dense.mesh import height_map_mesh
from semscape.metrology.areal import developed_area_ratio, developed_areas, height_parameters, root_mean_square_slope
from semscape.metrology.grid import Polygon, Region
from semscape.metrology.level import level
from semscape.metrology.planes import angle_between, fit_plane
from semscape.metrology.profile import extract_profile, profile_parameters
from semscape.metrology.step import step_between_regions
from semscape.metrology.volume import distance, volumes
from semscape.report.surface_file import decode_surface, encode_surface
from semscape.types import HeightMap, Reason
from synthetic_result import make_result

PIXEL = 0.05
RESULT = make_result(size=(96, 128))
CONTENT = encode_surface(RESULT.height_map)
# What the viewer has: heights as they were rounded, so that both sides measure the same.
HEIGHT = decode_surface(CONTENT).height_um.astype(np.float32).astype(np.float64)
CLOSE = 1e-5

MOUNT = """async ([content, state]) => {
  const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
  const surface = await viewer.decodeSurface(bytes.buffer);
  document.body.replaceChildren();
  window.handle = viewer.mountViewer(document.body, surface, { state });
  await window.handle.firstPicture;
  return Object.fromEntries([...document.querySelectorAll('.sv-table tr')].map(
    (row) => [row.dataset.name, Number(row.dataset.value)]));
}"""


@pytest.fixture
def measured(page: Any, viewer_bundle: str) -> Any:
    """Return a function of (tool, places, choices) that gives the figures the viewer's table shows."""
    page.set_content("<!DOCTYPE html><html lang='en'><title>t</title><body style='margin:0'></body></html>")
    page.evaluate(viewer_bundle.replace("var viewer =", "window.viewer =", 1))

    def figures(
        tool: str, places: list[tuple[int, int]], content: bytes = CONTENT, ends: Any = None, **choices: Any
    ) -> dict[str, float]:
        if ends is None:
            ends = list(range(2, len(places) + 1, 2)) if tool in {"step", "region", "texture"} else []
        marks = {"places": [{"x": x, "y": y} for x, y in places], "ends": ends}
        state = {"tool": tool, "marks": marks, "choices": choices}
        found: dict[str, float] = page.evaluate(MOUNT, [base64.b64encode(content).decode(), state])
        return found

    return figures


def test_a_profile_is_that_of_metrology(measured: Any) -> None:
    start, end = np.array([10.0, 80.0]), np.array([101.0, 30.0])
    found = measured("profile", [(10, 80), (101, 30)], nestingIndex=0.8)
    profile = extract_profile(HEIGHT, PIXEL, start, end)
    truth = profile_parameters(profile, 0.8)
    for name in ("Pa", "Pq", "Pt", "Ra", "Rq", "Rt"):
        assert found[name] == pytest.approx(truth[name], rel=1e-4), name
    assert found["Length"] == pytest.approx(profile.distance[-1])


def test_a_distance_is_that_of_metrology(measured: Any) -> None:
    found = measured("distance", [(20, 70), (90, 33)])
    truth = distance(HEIGHT, PIXEL, np.array([20.0, 70.0]), np.array([90.0, 33.0]))
    assert found["In the plane"] == pytest.approx(truth.lateral)
    assert found["In height"] == pytest.approx(truth.vertical, rel=CLOSE)
    assert found["In space"] == pytest.approx(truth.spatial, rel=CLOSE)


def test_an_angle_is_that_of_the_three_points(measured: Any) -> None:
    places = [(20, 70), (50, 50), (90, 33)]
    a, b, c = (np.array([x * PIXEL, y * PIXEL, HEIGHT[y, x]]) for x, y in places)
    cosine = (a - b) @ (c - b) / np.linalg.norm(a - b) / np.linalg.norm(c - b)
    assert measured("angle", places)["Angle"] == pytest.approx(np.rad2deg(np.arccos(cosine)), rel=CLOSE)


def test_a_step_is_that_of_metrology(measured: Any) -> None:
    first, second = Region(10, 60, 40, 90), Region(80, 30, 100, 70)
    found = measured("step", [(10, 60), (40, 90), (80, 30), (100, 70)])
    masks = [region.mask(HEIGHT.shape) for region in (first, second)]
    truth = step_between_regions(HEIGHT, PIXEL, *masks)
    assert found["Step height"] == pytest.approx(truth.height, rel=CLOSE)
    assert found["Perpendicular"] == pytest.approx(truth.perpendicular, rel=CLOSE)
    assert found["Residual"] == pytest.approx(truth.residual_rms, rel=CLOSE)
    angle = angle_between(*(fit_plane(HEIGHT, PIXEL, mask) for mask in masks))
    assert found["Angle"] == pytest.approx(np.rad2deg(angle), rel=CLOSE)


def test_area_and_volume_are_those_of_metrology(measured: Any) -> None:
    # Into the unknown corner, whose area is told.
    found = measured("region", [(100, 4), (120, 40)], reference="lowest")
    part = HEIGHT[4:41, 100:121]
    truth = volumes(part, PIXEL, float(np.nanmin(part)))
    developed, projected = developed_areas(part, PIXEL)
    assert found["Volume above"] == pytest.approx(truth.above, rel=CLOSE)
    assert found["Volume below"] == pytest.approx(0, abs=1e-9)
    assert found["Unknown area"] == pytest.approx(truth.unknown_area)
    assert truth.unknown_area > 0
    assert found["Projected area"] == pytest.approx(projected)
    assert found["Developed area"] == pytest.approx(developed, rel=CLOSE)


def test_a_bump_on_a_slope_has_its_volume_over_the_rim(measured: Any) -> None:
    rows, cols = np.indices((60, 60))
    bump = 3 * np.exp(-((rows - 30.0) ** 2 + (cols - 30.0) ** 2) / (2 * 5.0**2))
    some = HeightMap(
        0.2 * cols + bump,
        np.full((60, 60), 1e-3),
        np.full((60, 60), 2, np.uint8),
        np.zeros((60, 60), np.float32),
        1.0,
        np.diag([1.0, -1, 1, 1]),
        "um",
    )
    found = measured("region", [(5, 5), (55, 55)], encode_surface(some), reference="rim")
    assert found["Volume above"] == pytest.approx(3 * 2 * np.pi * 25, rel=2e-3)
    assert found["Volume below"] == pytest.approx(0, abs=0.5)
    octagon = [(5, 20), (20, 5), (40, 5), (55, 20), (55, 40), (40, 55), (20, 55), (5, 40)]
    found = measured("region", octagon, encode_surface(some), ends=[8], reference="rim")
    assert found["Volume above"] == pytest.approx(3 * 2 * np.pi * 25, rel=2e-3)
    assert found["Volume below"] == pytest.approx(0, abs=0.5)


@pytest.mark.parametrize("region", [None, (10, 20, 90, 80)])
def test_iso_25178_is_that_of_metrology(measured: Any, region: tuple[int, int, int, int] | None) -> None:
    part = HEIGHT if region is None else HEIGHT[region[1] : region[3] + 1, region[0] : region[2] + 1]
    found = measured("texture", [] if region is None else [region[:2], region[2:]])
    levelled = level(part, PIXEL).height
    truth = height_parameters(levelled)
    truth |= {"Sdq": root_mean_square_slope(levelled, PIXEL), "Sdr": developed_area_ratio(levelled, PIXEL)}
    assert found.keys() == truth.keys()
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=2e-4), name


# Concave, with edges along rows and columns and others, over a part of the unknown corner.
CORNERS = [(20, 20), (118, 4), (118, 60), (70, 40), (40, 88), (20, 88)]


def inside_the_polygon() -> tuple[np.ndarray, np.ndarray]:
    """Return the box around the polygon, and its heights with those beside the polygon unknown."""
    mask = Polygon(tuple((float(x), float(y)) for x, y in CORNERS)).mask(HEIGHT.shape)
    return mask[4:89, 20:119], np.where(mask, HEIGHT, np.nan)[4:89, 20:119]


def test_a_step_to_a_polygon_is_that_of_metrology(measured: Any) -> None:
    found = measured("step", [(2, 30), (14, 90), *CORNERS], ends=[2, 8])
    masks = [
        Region(2, 30, 14, 90).mask(HEIGHT.shape),
        Polygon(tuple((float(x), float(y)) for x, y in CORNERS)).mask(HEIGHT.shape),
    ]
    truth = step_between_regions(HEIGHT, PIXEL, *masks)
    assert found["Step height"] == pytest.approx(truth.height, rel=CLOSE)
    assert found["Residual"] == pytest.approx(truth.residual_rms, rel=CLOSE)
    angle = angle_between(*(fit_plane(HEIGHT, PIXEL, mask) for mask in masks))
    assert found["Angle"] == pytest.approx(np.rad2deg(angle), rel=CLOSE)


def test_area_and_volume_of_a_polygon_are_those_of_metrology(measured: Any) -> None:
    found = measured("region", CORNERS, ends=[6], reference="lowest")
    mask, part = inside_the_polygon()
    truth = volumes(part, PIXEL, float(np.nanmin(part)))
    developed, projected = developed_areas(part, PIXEL)
    assert found["Volume above"] == pytest.approx(truth.above, rel=CLOSE)
    assert found["Developed area"] == pytest.approx(developed, rel=CLOSE)
    assert found["Projected area"] == pytest.approx(projected)
    assert found["Unknown area"] == pytest.approx(np.count_nonzero(mask & np.isnan(part)) * PIXEL**2)
    assert found["Unknown area"] > 0


def test_iso_25178_of_a_polygon_is_that_of_metrology(measured: Any) -> None:
    found = measured("texture", CORNERS, ends=[6])
    levelled = level(inside_the_polygon()[1], PIXEL).height
    truth = height_parameters(levelled)
    truth |= {"Sdq": root_mean_square_slope(levelled, PIXEL), "Sdr": developed_area_ratio(levelled, PIXEL)}
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=2e-4), name


def test_too_little_that_is_known_is_said(measured: Any, page: Any) -> None:
    unknown = np.where(np.indices(HEIGHT.shape)[1] > 3, np.nan, HEIGHT)
    content = encode_surface(replace(RESULT.height_map, height_um=unknown))
    assert measured("profile", [(20, 20), (60, 20)], content) == {}
    assert "draw it over the known part" in page.inner_text(".sv-trouble")


def test_the_same_triangles_are_surface_as_in_the_mesh(measured: Any, page: Any, viewer_bundle: str) -> None:
    steep = HEIGHT.copy()
    steep[:, 64:] += 5.0
    cliff = replace(RESULT.height_map, height_um=steep)
    content = encode_surface(cliff)
    measured("inspect", [], content)
    count = page.evaluate(
        """async (content) => {
          const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
          const mask = viewer.triangleMask(await viewer.decodeSurface(bytes.buffer));
          return mask.reduce((sum, cell) => sum + (cell & 1) + (cell >> 1), 0);
        }""",
        base64.b64encode(content).decode(),
    )
    mesh = height_map_mesh(replace(cliff, height_um=decode_surface(content).height_um), max_vertices=10**9)
    assert count == len(mesh.faces)
    assert count < 2 * 95 * 127 - 95


def test_few_triangles_while_it_moves_and_all_when_still(measured: Any, page: Any) -> None:
    rows, cols = np.indices((700, 700))
    some = HeightMap(
        np.sin(rows / 40) + np.cos(cols / 30),
        np.full((700, 700), 1e-2),
        np.full((700, 700), 2, np.uint8),
        np.zeros((700, 700), np.float32),
        0.1,
        np.diag([0.1, -0.1, 1, 1]),
        "um",
    )
    measured("inspect", [], encode_surface(some))
    page.wait_for_selector(".sv-root[data-picture=still]")
    assert int(page.get_attribute(".sv-root", "data-triangles")) >= 2 * 699**2
    page.locator("canvas[data-name=surface]").focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_selector(".sv-root[data-picture=moving]")
    assert 20_000 < int(page.get_attribute(".sv-root", "data-triangles")) <= 180_000 * 1.1


def test_what_was_set_is_there_again(measured: Any, page: Any) -> None:
    measured("profile", [(10, 80), (101, 30)])
    page.select_option("select[aria-label='Colour by']", "sigma")
    page.click("text=Orthographic")
    kept = page.evaluate("window.handle.state()")
    page.evaluate(
        """async ([content, state]) => {
          window.handle.dispose();
          const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
          window.handle = viewer.mountViewer(document.body, await viewer.decodeSurface(bytes.buffer), { state });
          await window.handle.firstPicture;
        }""",
        [base64.b64encode(CONTENT).decode(), kept],
    )
    assert page.input_value("select[aria-label='Colour by']") == "sigma"
    assert page.get_attribute("button:has-text('Orthographic')", "aria-pressed") == "true"
    assert page.locator(".sv-table tr[data-name=Rq]").count() == 1
    assert page.evaluate("window.handle.state()") == kept


def test_the_cursor_tells_why_a_height_is_unknown(measured: Any, page: Any) -> None:
    reason = np.where(np.isfinite(RESULT.height_map.height_um), Reason.KNOWN, Reason.OCCLUDED).astype(np.uint8)
    measured("inspect", [], encode_surface(replace(RESULT.height_map, reason=reason)))
    page.locator("canvas[data-name=map]").focus()
    for key in [*["Shift+ArrowRight"] * 7, *["Shift+ArrowUp"] * 5]:
        page.keyboard.press(key)
    assert "unknown (occluded)" in page.inner_text(".sv-readout")


def test_bytes_that_are_no_surface_are_refused_in_words(measured: Any, page: Any) -> None:
    measured("inspect", [])
    said = page.evaluate("viewer.decodeSurface(new ArrayBuffer(64)).catch((error) => error.message)")
    assert said == "this is no surface of semscape, or one of a newer version"
