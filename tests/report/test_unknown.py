"""The report's part about what is known from how many views, and why not elsewhere."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from semscape.report.summary import reason_shares
from semscape.report.unknown import coverage_picture, unknown_html
from semscape.types import HeightMap, Reason
from synthetic_result import make_result


@pytest.fixture(scope="module")
def half() -> HeightMap:
    """Return a map of which a half is unknown: three eighths occluded, one eighth without texture."""
    given = make_result().height_map
    rows, columns = given.height_um.shape
    reason = np.zeros((rows, columns), np.uint8)
    reason[: rows // 2] = Reason.OCCLUDED
    reason[: rows // 2, : columns // 4] = Reason.NO_TEXTURE
    height = np.where(reason == 0, 1.0, np.nan)
    return replace(given, height_um=height, reason=reason, n_views=np.where(reason == 0, 3, 0).astype(np.uint8))


def test_the_table_tells_the_share_of_each_reason(half: HeightMap) -> None:
    shares = reason_shares(half)
    assert set(shares) == {"occluded", "no_texture"}
    assert shares["occluded"] == pytest.approx(3 / 8, abs=0.02)
    html = unknown_html(half)
    rows = re.findall(r'<th scope="row">([^<]*)</th><td class="num">([^<]*)</td>', html)
    assert [name for name, _ in rows] == ["occluded", "no texture"]
    assert float(rows[0][1].removesuffix(" %")) == pytest.approx(100 * shares["occluded"], rel=0.01)


def test_where_all_is_known_there_is_nothing_to_tell(half: HeightMap) -> None:
    known = replace(half, reason=np.zeros_like(half.reason), height_um=np.ones_like(half.height_um))
    assert unknown_html(known) == ""


def test_the_picture_shows_the_reasons_in_their_colours(half: HeightMap) -> None:
    with Image.open(io.BytesIO(coverage_picture(half))) as picture:
        rgb = np.asarray(picture.convert("RGBA")).astype(int)[..., :3]
    occluded = (np.abs(rgb - [0xD5, 0x5E, 0x00]).max(axis=2) < 12).sum()
    textureless = (np.abs(rgb - [0x56, 0xB4, 0xE9]).max(axis=2) < 12).sum()
    assert 2 < occluded / textureless < 4
