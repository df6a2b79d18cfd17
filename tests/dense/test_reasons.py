"""Why heights are unknown, for scenes in which one reason alone holds at each place."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from semscape.dense.groups import _reconstruction
from semscape.dense.reasons import unknown_reasons
from semscape.types import HeightMap, Micrograph, Motion, Reason, Reconstruction, SemMetadata, TiltSeries

SIDE = 160
TILT = np.deg2rad([-8.0, 0.0, 8.0])


def scene(height: NDArray[np.float64]) -> tuple[TiltSeries, Reconstruction, HeightMap]:
    """Return three views of noise about a vertical axis, which need not show the heights, and a map that holds them."""
    rng = np.random.default_rng(0)
    centre = np.full((3, 2), (SIDE - 1) / 2)
    motion = Motion(np.pi / 2, TILT, np.zeros(3), np.ones(3), np.zeros(3), centre)
    views = tuple(
        Micrograph(
            f"{k}.tif",
            (128 + 40 * cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)), (0, 0), 1.5)).astype(np.float32),
            np.ones((SIDE, SIDE), bool),
            SemMetadata(pixel_size_um=1.0, tilt_rad=float(tilt)),
        )
        for k, tilt in enumerate(TILT)
    )
    series = TiltSeries(views)
    points = np.column_stack([np.zeros((50, 2)), np.linspace(0, 40, 50)])
    grid = np.diag([1.0, -1.0, 1.0, 1.0])
    grid[:2, 3] = -(SIDE - 1) / 2, (SIDE - 1) / 2
    known = np.isfinite(height).astype(np.uint8)
    height_map = HeightMap(height, np.ones_like(height), 3 * known, height.astype(np.float32), 1.0, grid, "um")
    return series, _reconstruction(motion, points, 1, series), height_map


def spoilt(series: TiltSeries, which: tuple[int, ...], change: str) -> TiltSeries:
    """Spoil columns 40 to 120 of some views."""
    views = list(series.views)
    for k in which:
        image, mask = views[k].image.copy(), views[k].mask.copy()
        if change == "masked":
            mask[:, 40:120] = False
        elif change == "white":
            image[:, 40:120] = image.max()
        else:
            image[:, 40:120] = 128 + 0.5 * np.random.default_rng(k).standard_normal((SIDE, 80))
            image += 0.5 * np.random.default_rng(k).standard_normal(image.shape)
        views[k] = replace(views[k], image=image.astype(np.float32), mask=mask)
    return TiltSeries(tuple(views))


def gap() -> NDArray[np.float64]:
    height = np.zeros((SIDE, SIDE))
    height[70:90, 75:85] = np.nan
    return height


def test_nothing_unknown_has_no_reason() -> None:
    series, reconstruction, height_map = scene(np.zeros((SIDE, SIDE)))
    assert not unknown_reasons(series, reconstruction, height_map).any()


@pytest.mark.parametrize(
    ("views", "change", "reason"),
    [
        ((), "", Reason.INCONSISTENT),
        ((0, 2), "masked", Reason.MASKED),
        ((0,), "masked", Reason.INCONSISTENT),  # two views still see it
        ((1, 2), "white", Reason.SATURATED),
        ((0, 1), "blank", Reason.NO_TEXTURE),
    ],
)
def test_what_two_views_lack_is_the_reason(views: tuple[int, ...], change: str, reason: Reason) -> None:
    series, reconstruction, height_map = scene(gap())
    told = unknown_reasons(spoilt(series, views, change), reconstruction, height_map)
    unknown = np.isnan(height_map.height_um)
    assert (told[unknown] == reason).mean() > 0.95
    assert not told[~unknown].any()


def test_ground_between_two_walls_is_occluded_as_far_as_the_beams_say() -> None:
    """A trench 12 px wide and 100 px deep: beams at 8 deg reach its floor from none of the tilted views."""
    height = np.full((SIDE, SIDE), 100.0)
    height[:, 74:86] = 0.0
    height[70:90, 74:86] = np.nan
    series, reconstruction, height_map = scene(height)
    told = unknown_reasons(series, reconstruction, height_map)[70:90, 74:86]
    assert (told == Reason.OCCLUDED).mean() > 0.9
    shallow = np.where(np.isnan(height), np.nan, 0.2 * height)  # 20 px deep hide 3 px from each side
    told = unknown_reasons(series, reconstruction, replace(height_map, height_um=shallow))[70:90, 74:86]
    assert (told[:, 4:8] == Reason.INCONSISTENT).all()


def test_ground_clipped_to_black_is_without_texture_up_to_its_rim() -> None:
    """Most of the image has no noise then; it must not make texture of the blurred rim of what is beside it."""
    height = np.zeros((SIDE, SIDE))
    height[70:90, 50:110] = np.nan
    series, reconstruction, height_map = scene(height)
    views = list(series.views)
    for k, view in enumerate(views):
        noise = np.random.default_rng(k).standard_normal(view.image.shape)
        image = 40 + 0.1 * (view.image - 128) + 8 * noise
        image[:, 30:130] = 0
        views[k] = replace(view, image=image.astype(np.float32))
    told = unknown_reasons(TiltSeries(tuple(views)), reconstruction, height_map)
    assert (told[70:90, 50:110] == Reason.NO_TEXTURE).mean() > 0.95


def test_what_lies_beyond_the_field_is_outside() -> None:
    height = np.zeros((SIDE, SIDE))
    height[:, :6] = np.nan
    series, reconstruction, height_map = scene(height)
    shifted = replace(reconstruction.motion, translation_px=reconstruction.motion.translation_px - [20.0, 0.0])
    told = unknown_reasons(series, replace(reconstruction, motion=shifted), height_map)
    assert (told[:, :6] == Reason.OUTSIDE).all()
