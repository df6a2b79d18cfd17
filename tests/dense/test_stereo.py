"""Semi-global matching and its checks on random texture with known disparities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from semscape.dense.semi_global import census, match_rows
from semscape.dense.stereo import RectifiedView, consistent, pair_heights, without_speckles
from semscape.options import DenseOptions

OPTIONS = DenseOptions()
SHAPE = (120, 260)
MARGIN = 60


def texture(seed: int = 0) -> np.ndarray:
    rough = np.random.default_rng(seed).normal(size=(SHAPE[0], SHAPE[1] + 2 * MARGIN))
    smooth = gaussian_filter(rough, 1.1)
    return np.asarray(128 + 40 * smooth / smooth.std())


TEXTURE, OTHER = texture(), texture(1)


def look(heights: list[tuple[np.ndarray, np.ndarray]], parallax: float) -> RectifiedView:
    """Draw a view in which the point of height h(u) at u is seen at u + h parallax.

    `heights` lists surfaces as (height (W,), exists (W,)) over u; where they overlap the higher one is seen, and
    where none is seen stands another texture.
    """
    columns = SHAPE[1]
    u = np.arange(columns, dtype=float)
    best, source = np.full(columns, -np.inf), np.full(columns, np.nan)
    for height, exists in heights:
        x = u + height * parallax
        at = np.interp(np.arange(columns), x, u, left=np.nan, right=np.nan)
        nearest = np.clip(np.rint(np.nan_to_num(at)).astype(int), 0, columns - 1)
        here = np.isfinite(at) & exists[nearest]
        h = np.interp(np.nan_to_num(at), u, height)
        take = here & (h > best)
        best, source = np.where(take, h, best), np.where(take, at, source)
    row = np.indices(SHAPE, dtype=float)[0]
    seen = np.isfinite(source)
    image = map_coordinates(TEXTURE, [row, np.broadcast_to(np.nan_to_num(source) + MARGIN, SHAPE)], order=3)
    image = np.where(seen, image, OTHER[:, MARGIN:-MARGIN])
    valid = np.broadcast_to(seen, SHAPE).copy()
    return RectifiedView(image.astype(np.float32), valid, parallax)


def noisy(view: RectifiedView, sigma: float, seed: int, gain: float = 1.0, offset: float = 0.0) -> RectifiedView:
    noise = np.random.default_rng(seed).normal(0, sigma, SHAPE)
    return replace(view, image=(gain * (view.image + noise) + offset).astype(np.float32))


U = np.arange(SHAPE[1], dtype=float)
ALL = np.ones(SHAPE[1], bool)
FLAT = [(np.full(SHAPE[1], 12.0), ALL)]
RAMP = [(0.25 * (U - 130), ALL)]


def pair(surface, g: float = 0.1, noise: float = 3.0) -> tuple[RectifiedView, RectifiedView]:
    return noisy(look(surface, -g), noise, 1), noisy(look(surface, g), noise, 2)


@pytest.mark.parametrize("shift", [-7, 0, 5])
def test_match_rows_recovers_a_constant_shift(shift: int) -> None:
    image1 = TEXTURE[:, MARGIN:-MARGIN].astype(np.float32)
    image2 = TEXTURE[:, MARGIN - shift : MARGIN - shift + SHAPE[1]].astype(np.float32)  # x2 = x1 + shift
    valid = np.ones(SHAPE, bool)
    start = np.full(SHAPE, -10, np.int32)
    found, _ = match_rows(census(image1, 3), valid, census(image2, 3), valid, start, 20, 4.0, 24.0)
    inner = found[5:-5, 20:-20]
    assert np.isfinite(inner).mean() > 0.99
    assert np.nanmedian(inner) == pytest.approx(shift, abs=0.1)
    assert np.nanmean(np.abs(inner - shift) < 0.5) > 0.99


def test_match_rows_follows_a_range_of_its_own_for_every_pixel() -> None:
    image1 = TEXTURE[:, MARGIN:-MARGIN].astype(np.float32)
    image2 = TEXTURE[:, MARGIN - 6 : MARGIN - 6 + SHAPE[1]].astype(np.float32)
    valid = np.ones(SHAPE, bool)
    start = (6 - 4 + np.random.default_rng(0).integers(-2, 2, (SHAPE[0] // 10, SHAPE[1] // 10))).astype(np.int32)
    start = np.repeat(np.repeat(start, 10, axis=0), 10, axis=1)
    found, _ = match_rows(census(image1, 3), valid, census(image2, 3), valid, start, 10, 4.0, 24.0)
    assert np.nanmean(np.abs(found[5:-5, 20:-20] - 6) < 0.5) > 0.98


def test_what_is_outside_the_range_or_the_image_is_unknown() -> None:
    image = TEXTURE[:, MARGIN:-MARGIN].astype(np.float32)
    valid = np.ones(SHAPE, bool)
    valid[:, 100:140] = False
    words = census(image, 3)
    found, _ = match_rows(words, valid, words, valid, np.full(SHAPE, -4, np.int32), 9, 4.0, 24.0)
    assert np.isnan(found[:, 100:140]).all()
    beyond, _ = match_rows(words, ~valid | True, words, ~valid | True, np.full(SHAPE, 0, np.int32), 9, 4.0, 24.0)
    assert np.isnan(beyond[5:-5, 20:-20]).mean() > 0.95  # the best lies at the end of the range


def test_census_knows_no_brightness() -> None:
    image = TEXTURE[:, MARGIN:-MARGIN].astype(np.float32)
    np.testing.assert_array_equal(census(image, 3), census(np.exp(image / 60).astype(np.float32), 3))
    assert census(image, 3)[60, 60] != census(image, 3)[61, 61]


def test_a_plane_is_recovered_to_a_fraction_of_a_pixel() -> None:
    found = pair_heights(*pair(FLAT), (-40.0, 40.0), OPTIONS)
    inner = found[8:-8, 30:-30]
    assert np.isfinite(inner).mean() > 0.95
    disparity_error = (inner - 12.0) * 0.2
    assert abs(np.nanmedian(disparity_error)) < 0.08
    assert np.nanmedian(np.abs(disparity_error)) < 0.25


def test_a_ramp_is_recovered() -> None:
    view1, view2 = pair(RAMP)
    found = pair_heights(view1, view2, (-45.0, 45.0), OPTIONS)
    # Pixel x of view 1 sees u with x = u - 0.1 h(u).
    u = (U - 0.1 * 0.25 * 130) / (1 - 0.1 * 0.25)
    error = (found - 0.25 * (u - 130)) * 0.2
    inner = error[8:-8, 30:-30]
    assert np.isfinite(inner).mean() > 0.95
    assert abs(np.nanmedian(inner)) < 0.08
    assert np.nanpercentile(np.abs(inner), 90) < 0.5


def step(height: float) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(np.zeros(SHAPE[1]), U < 130), (np.full(SHAPE[1], height), U >= 130)]


@pytest.mark.parametrize("height", [30.0, 60.0])
def test_a_step_stays_a_step(height: float) -> None:
    found = pair_heights(*pair(step(height)), (-10.0, height + 10.0), OPTIONS)
    low, high = found[8:-8, 20:105], found[8:-8, 150:235]
    for part, level in ((low, 0.0), (high, height)):
        assert np.isfinite(part).mean() > 0.9
        assert abs(np.nanmedian(part) - level) * 0.2 < 0.15
    # Nothing hangs between the two levels.
    known = found[8:-8][np.isfinite(found[8:-8])]
    between = (known > 0.25 * height) & (known < 0.75 * height)
    assert between.mean() < 0.03


def test_brightness_and_contrast_do_not_matter() -> None:
    view1, view2 = pair(RAMP)
    changed = noisy(view2, 0.0, 0, gain=0.4, offset=900.0)
    plain, dim = (pair_heights(view1, other, (-45.0, 45.0), OPTIONS) for other in (view2, changed))
    both = np.isfinite(plain) & np.isfinite(dim)
    assert both.mean() > 0.8
    assert np.mean(np.abs(plain - dim)[both] * 0.2 < 0.05) > 0.99


def test_swapping_the_views_keeps_the_heights() -> None:
    view1, view2 = pair(FLAT)
    there, back = pair_heights(view1, view2, (-40.0, 40.0), OPTIONS), pair_heights(view2, view1, (-40.0, 40.0), OPTIONS)
    assert np.nanmedian(there) == pytest.approx(np.nanmedian(back), abs=1.0)


def test_pictures_of_other_things_have_no_heights() -> None:
    view1 = noisy(look(FLAT, -0.1), 3, 1)
    view2 = replace(view1, image=texture(9)[:, MARGIN:-MARGIN].astype(np.float32), parallax=0.1)
    assert np.isfinite(pair_heights(view1, view2, (-60.0, 60.0), OPTIONS)).mean() < 0.25


def test_the_left_right_check_keeps_what_both_sides_say() -> None:
    one, two = np.full((3, 20), 2.0), np.full((3, 20), -2.0)
    two[1, 10] = 5.0
    one[0, 5] = np.nan
    kept = consistent(one, two, 1.0)
    assert np.isnan(kept[1, 8])  # 8 + 2 = 10 disagrees
    assert np.isnan(kept[0, 5])
    assert np.isnan(kept[:, 18:]).all()  # beyond the image
    assert np.isfinite(kept).sum() == 3 * 18 - 2


def test_speckles_are_dropped_and_patches_stay() -> None:
    disparity = np.full((40, 60), 3.0)
    disparity[10:13, 10:13] = 30.0
    disparity[20:36, 30:46] = 12.0
    kept = without_speckles(disparity, 60)
    assert np.isnan(kept[10:13, 10:13]).all()
    np.testing.assert_allclose(kept[20:36, 30:46], 12.0)
    assert np.isfinite(kept).sum() == disparity.size - 9
