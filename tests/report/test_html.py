from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from semscape.report import render_html
from synthetic_result import make_result, with_reconstruction, with_report

RESULT = make_result()


class Page(HTMLParser):
    """Collects what a browser would load, the open tags and the visible text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.loads += [value or "" for name, value in attributes if name in ("src", "href", "srcset", "data")]
        if tag not in ("img", "meta"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data


def page_of(result) -> Page:
    return Page(render_html(result))


@pytest.fixture(scope="module")
def html() -> str:
    return render_html(RESULT)


def test_the_page_asks_the_network_for_nothing(html: str) -> None:
    page = Page(html)
    assert page.open == []
    assert len(page.loads) == 6
    assert all(load.startswith("data:image/png;base64,") for load in page.loads)
    assert "http" not in re.sub(r"data:[^\"]*|http-equiv", "", html)
    assert "<script" not in html
    assert "@import" not in html
    assert "prefers-color-scheme: dark" in html


@pytest.mark.parametrize(
    "words",
    [
        "good: heights to ±1.1% (95 %), residual 0.21 px rms",
        "0.05 µm (user)",
        "Pairs 0–1, 1–2",
        "Height scale ±1.1 % (95 %)",
        "-3.020 ± 0.023",
        "20.0200 ± 0.0060",
        "0.214 px",
        "93.4 %",
        "grain_a.tif – grain_b.tif",
        "300 / 300",
        "7,011",
        "6,567",
        "6,011",
        "0.83",
        "-9,012",
        "11.60",
        "812 MB",
        "multi-page TIFF, only its first page was read",
        "prior_tilt_deg",
        "seed 0",
        "numpy",
        "abababababababab",
        "The height scale and the sign of the relief are fixed by the stage tilts in the files.",
    ],
)
def test_the_page_states(html: str, words: str) -> None:
    assert words in Page(html).text


def test_a_series_without_pixel_size_says_px_everywhere() -> None:
    text = page_of(make_result("px")).text
    assert "µm" not in text.replace("0.05 µm", "")
    assert "Scale (px/px)" in text


def test_names_are_text_and_never_markup() -> None:
    name = "<script>alert('x')</script>&.tif"
    views = (replace(RESULT.series.views[0], name=name), *RESULT.series.views[1:])
    result = with_report(replace(RESULT, series=replace(RESULT.series, views=views)), warnings=(f"{name}: odd",))
    html = render_html(result)
    assert "<script" not in html
    assert name in Page(html).text


def test_the_sign_voted_by_shading_is_said_with_the_way_out() -> None:
    mirrored = with_reconstruction(
        RESULT,
        ambiguity="reflection",
        relief_confidence=0.83,
        tilt_source="self-calibrated",
        tilt_prior_rad=np.full(3, np.nan),
    )
    text = page_of(mirrored).text
    assert "voted by shading (confidence 83 %)" in text
    assert "--invert-relief" in text


def test_two_views_say_what_the_height_scale_rests_on() -> None:
    text = page_of(with_reconstruction(RESULT, ambiguity="bas_relief", tilt_source="user")).text
    assert "rests on the tilts given by the user alone" in text


def test_failures_come_before_anything_else() -> None:
    text = page_of(with_report(RESULT, failures=("pair a - b: 11 matches, need 24",))).text
    assert text.index("need 24") < text.index("Height range")


def test_a_result_with_little_known_still_has_a_page() -> None:
    bare = with_report(
        RESULT, stages=(), pairs=(), metrics={}, inputs=(), versions={}, peak_memory_mb=np.nan, options={}
    )
    bare = with_reconstruction(bare, height_scale_relative_sigma=np.nan, covariance=np.full((19, 19), np.nan))
    nothing = np.full_like(RESULT.height_map.height_um, np.nan)
    bare = replace(
        bare,
        geometries=(),
        matches=(),
        height_map=replace(RESULT.height_map, height_um=nothing, uncertainty_um=nothing),
    )
    page = page_of(bare)
    assert "height scale: uncertainty unknown" in page.text.lower()
    assert len(page.loads) == 5
    assert "nan" not in page.text.lower().split()
