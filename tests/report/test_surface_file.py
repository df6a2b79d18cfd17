from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semscape.report.surface_file import Camera, decode_surface, encode_surface, surface_of_result
from semscape.types import HeightMap, Reason
from synthetic_result import make_result

RESULT = make_result()
MAP = RESULT.height_map


def header_of(content: bytes) -> dict:
    import json

    return json.loads(content[12 : 12 + int.from_bytes(content[8:12], "little")])


def test_heights_come_back_far_within_their_uncertainty() -> None:
    content = surface_of_result(RESULT)
    read, step = decode_surface(content), header_of(content)["height_step"]
    known = np.isfinite(MAP.height_um)
    assert np.array_equal(np.isfinite(read.height_um), known)
    assert np.nanmax(np.abs(read.height_um - MAP.height_um)) <= 0.5001 * step
    assert step <= np.nanpercentile(MAP.uncertainty_um, 5) / 16
    assert np.nanmax(np.abs(read.uncertainty_um / MAP.uncertainty_um - 1)) <= 0.016
    assert np.array_equal(read.n_views, np.where(known, MAP.n_views, 0))
    assert np.array_equal(read.world_from_grid, MAP.world_from_grid)
    assert read.length_unit == "um"


def test_the_same_result_gives_the_same_bytes() -> None:
    assert surface_of_result(RESULT) == surface_of_result(RESULT)


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(1, 9),
    cols=st.integers(1, 9),
    scale=st.floats(1e-9, 1e9),
    offset=st.floats(-1e6, 1e6),
    unknown=st.floats(0, 1),
    seed=st.integers(0, 2**16),
)
def test_any_map_comes_back(rows: int, cols: int, scale: float, offset: float, unknown: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    height = rng.normal(offset, scale, (rows, cols))
    height[rng.random((rows, cols)) < unknown] = np.nan
    sigma = np.where(rng.random((rows, cols)) < 0.2, np.nan, np.abs(rng.normal(0, scale, (rows, cols))))
    some = HeightMap(
        height, sigma, np.full((rows, cols), 3, np.uint8), np.zeros((rows, cols), np.float32), 0.5, np.eye(4), "px"
    )
    content = encode_surface(some)
    read, step = decode_surface(content), header_of(content)["height_step"]
    assert np.array_equal(np.isfinite(read.height_um), np.isfinite(height))
    close = np.abs(read.height_um - height) <= 0.5001 * step + 1e-15 * abs(offset)
    assert close[np.isfinite(height)].all()
    stated = np.isfinite(height) & np.isfinite(sigma) & (sigma > 0)
    assert np.array_equal(np.isfinite(read.uncertainty_um), stated)


def test_a_jump_needs_more_bytes_and_keeps_its_height() -> None:
    height = np.zeros(MAP.height_um.shape)
    height[:, 25:] = 1000.0
    read = decode_surface(encode_surface(replace(MAP, height_um=height, uncertainty_um=np.full(height.shape, 1e-3))))
    assert read.height_um[0, 30] - read.height_um[0, 10] == pytest.approx(1000.0, abs=1e-4)


def test_a_map_that_is_too_large_keeps_every_nth_row_and_column_where_it_was() -> None:
    content = encode_surface(MAP, most_heights=MAP.height_um.size // 5)
    read, header = decode_surface(content), header_of(content)
    assert header["stride"] == 3
    assert header["full_shape"] == list(MAP.height_um.shape)
    assert read.height_um.shape == MAP.height_um[::3, ::3].shape
    assert read.pixel_size_um == pytest.approx(3 * MAP.pixel_size_um)
    here, there = (m.world_from_grid @ [c, r, 0, 1] for m, c, r in ((read, 4, 5), (MAP, 12, 15)))
    assert here == pytest.approx(there)


def test_cameras_and_unknown_numbers_are_plain_json() -> None:
    camera = Camera("a.tif", 3.0, np.nan, np.eye(3), True)
    header = header_of(encode_surface(MAP, cameras=[camera]))
    assert header["cameras"][0]["tilt_sigma_deg"] is None
    assert header["cameras"][0]["rotation"] == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert header["height_scale_relative_sigma"] is None


def test_why_heights_are_unknown_comes_along() -> None:
    reason = np.where(np.isfinite(MAP.height_um), Reason.KNOWN, Reason.OCCLUDED).astype(np.uint8)
    reason[0, -1] = Reason.NO_TEXTURE
    content = encode_surface(replace(MAP, reason=reason))
    assert np.array_equal(decode_surface(content).reason, reason)
    assert header_of(content)["reasons"] == {"3": "occluded", "5": "no texture"}
    assert "reason" not in header_of(encode_surface(replace(MAP, reason=np.empty((0, 0), np.uint8))))["planes"]


def test_other_bytes_are_refused() -> None:
    with pytest.raises(ValueError, match="no surface container"):
        decode_surface(b"PK\x03\x04 something else")
