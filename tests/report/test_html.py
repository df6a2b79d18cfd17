from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy import ndimage

from semscape.metrology.areal import height_parameters
from semscape.metrology.level import level
from semscape.report import render_html
from semscape.report.wording import number
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
        self.loads += [
            value or ""
            for name, value in attributes
            if name in ("src", "href", "srcset", "data") and tag != "a" and not (value or "").startswith("#")
        ]
        if tag not in ("img", "meta"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.text += data


def page_of(result) -> Page:
    return Page(render_html(result))


@pytest.fixture(scope="module")
def html() -> str:
    return render_html(RESULT)


def test_the_page_asks_the_network_for_nothing(html: str) -> None:
    page = Page(html)
    assert page.open == []
    assert len(page.loads) == 5 + RESULT.series.n_views  # each view once, whatever the number of its pairs
    assert all(load.startswith(("data:image/webp;base64,", "data:image/jpeg;base64,")) for load in page.loads)
    without_script = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    papers = 'href="https://doi.org/'  # followed by a click alone
    assert "http" not in re.sub(r"data:[^\"]*|http-equiv", "", without_script.replace(papers, ""))
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
    assert "alert(" not in re.sub(r"&lt;script&gt;alert\(", "", html)
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
    assert len(page.loads) == 5  # no pair, no view
    without_options_file = page.text.lower().partition("options.toml")[0]  # where nan is a value
    assert "nan" not in without_options_file.split()


def test_the_browser_runs_the_viewer_and_no_other_script(html: str) -> None:
    scripts = re.findall(r"<script>(.*?)</script>", html, flags=re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in html
    assert "default-src 'none'" in html


def test_the_page_of_a_source_tree_without_the_viewer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("semscape.report.html.viewer_script", lambda: None)
    html = render_html(RESULT)
    assert "<script" not in html
    assert "script-src" not in html
    assert "make web" in Page(html).text


def test_every_pair_has_its_drawing(html: str) -> None:
    text = Page(html).text
    for found, geometry in zip(RESULT.matches, RESULT.geometries, strict=True):
        first, second = (RESULT.series.names[view] for view in geometry.pair)
        assert f"{first} – {second}: {geometry.inliers.sum():,} inliers of {len(found):,} matches" in text


def test_residuals_stand_per_view() -> None:
    found = RESULT.reconstruction
    view = found.observations.view == 1
    rms = np.sqrt((found.residual_px[view & (found.weights > 0)] ** 2).sum(axis=1).mean())
    assert f"{rms:.3g}" in page_of(RESULT).text


def test_what_no_file_told_is_said() -> None:
    inputs = tuple({**item, "source": {"pixel_size_um": "assumed"}} for item in RESULT.report.inputs)
    assert "Pixel size: assumed, for every view." in page_of(with_report(RESULT, inputs=inputs)).text


def test_texture_is_that_of_metrology(html: str) -> None:
    levelled = level(RESULT.height_map.height_um, RESULT.height_map.pixel_size_um).height
    assert number(height_parameters(levelled)["Sku"]) in Page(html).text


def test_a_map_of_a_megapixel_makes_a_page_below_4_mb() -> None:
    rng = np.random.default_rng(0)
    size = 1024
    y, x = np.mgrid[:size, :size] / 40
    smooth = ndimage.gaussian_filter(rng.normal(size=(size, size)), 2) * 0.5
    heights = np.sin(x) * np.cos(y) * 3 + smooth
    large = replace(
        RESULT.height_map,
        height_um=heights,
        uncertainty_um=0.1 * np.exp(ndimage.gaussian_filter(rng.normal(size=(size, size)), 3) * 4),
        n_views=rng.integers(2, 6, (size, size)).astype(np.uint8),
        texture=rng.normal(128, 30, (size, size)).astype(np.float32),
        pixel_size_um=0.1,
        world_from_grid=np.diag([0.1, -0.1, 1.0, 1.0]),
    )
    assert len(render_html(replace(RESULT, height_map=large)).encode()) < 4e6


def test_a_notebook_gets_the_viewer_and_a_picture_for_no_scripts() -> None:
    frame = RESULT._repr_html_()
    assert frame.startswith("<iframe srcdoc=")
    assert "allow-same-origin" not in frame
    assert "semscape-surface" in frame
    assert "noscript&gt;&lt;img src=&quot;data:image/png" in frame


def test_each_view_has_its_prior_beside_its_posterior() -> None:
    sigma = np.concatenate([[np.inf], np.tile([np.deg2rad(0.1), np.deg2rad(0.5), 0.002, 0.0007], 3)])
    mean = np.zeros(13)
    mean[1::4] = np.deg2rad([-3.0, 0.0, 3.0])
    told = with_reconstruction(
        RESULT,
        prior_mean=mean,
        prior_sigma=sigma,
        mirror_margin=812.04,
        height_scale_relative_sigma_of_images=0.04,
        camera_margin=-6.2,
    )
    text = page_of(told).text
    for words in (
        "-3.00 ± 0.10",
        "± 0.5",
        "± 0.2",
        "± 0.07",
        "The mirror image costs 812 more",
        "the images alone would tell ±7.8 %",
        "A perspective camera fits worse: its information criterion differs by 6.2; taken: orthographic.",
    ):
        assert words in text, words
    free = with_reconstruction(told, prior_sigma=np.where(np.arange(13) % 4 == 1, np.inf, sigma))
    assert "free" in page_of(free).text
    assert "Before and after" not in page_of(RESULT).text
