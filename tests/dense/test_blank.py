"""A free-standing body before a void that is one grey: nothing is known beside it."""

from __future__ import annotations

import cv2
import numpy as np

from semscape.dense.blank import blank
from semscape.dense.groups import _reconstruction
from semscape.dense.tiles import surface_in_tiles
from semscape.options import DenseOptions
from semscape.types import FloatArray, Micrograph, Motion, Reason, SemMetadata, TiltSeries

SIDE, HALF = 192, 45
TILT = np.deg2rad([-6.0, 0.0, 6.0])


def plate(tilt_rad: float, texture: FloatArray, void: float) -> Micrograph:
    """Return a textured square plate of height zero, tilted about a vertical axis, before a void of one grey."""
    x, y = np.meshgrid(*2 * [np.arange(SIDE) - (SIDE - 1) / 2])
    x = x / np.cos(tilt_rad)
    on_plate = (np.abs(x) < HALF) & (np.abs(y) < HALF)
    seen = cv2.remap(
        texture.astype(np.float32), *(np.float32(a + (SIDE - 1) / 2) for a in (x, y)), interpolation=cv2.INTER_CUBIC
    )
    noise = np.random.default_rng(int(1000 + 1000 * tilt_rad)).normal(0, 2, seen.shape)
    image = np.rint(np.where(on_plate, seen + noise, void)).astype(np.float32)
    return Micrograph(f"{tilt_rad:.2f}.tif", image, image >= 0, SemMetadata(pixel_size_um=1.0, tilt_rad=tilt_rad))


def test_a_void_of_one_grey_holds_no_height_and_is_without_texture() -> None:
    rng = np.random.default_rng(0)
    texture = 130 + 40 * cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)), (0, 0), 1.5) / 0.19
    views = tuple(plate(float(tilt), texture, 40.0) for tilt in TILT)
    motion = Motion(np.pi / 2, TILT, np.zeros(3), np.ones(3), np.zeros(3), np.full((3, 2), (SIDE - 1) / 2))
    points = np.column_stack([np.zeros((50, 2)), np.linspace(-30, 30, 50)])
    series = TiltSeries(views)
    found = surface_in_tiles(series, _reconstruction(motion, points, 1, series), DenseOptions()).height_map
    known = np.isfinite(found.height_um)
    x, y = np.meshgrid(*2 * [np.abs(np.arange(SIDE) - (SIDE - 1) / 2)])
    inner, beyond = np.maximum(x, y) < HALF - 6, np.maximum(x, y) > HALF + 8
    assert known[inner].mean() > 0.98
    assert 0.001 < np.median(np.abs(found.height_um[inner & known])) < 0.7
    assert not known[beyond].any()
    assert (found.reason[beyond] == Reason.NO_TEXTURE).mean() > 0.9


def test_blank_is_what_differs_by_no_more_than_one_grey_level_and_weak_noise_is_not() -> None:
    rng = np.random.default_rng(1)
    image = np.full((40, 60), 7.0, np.float32)
    image[:, 30:] += rng.integers(0, 2, (40, 30))
    assert blank(Micrograph("dither.tif", image, image > 0)).all()
    image[:, 30:] = np.rint(50 + 1.5 * rng.standard_normal((40, 30)))
    found = blank(Micrograph("noise.tif", image, image > 0))
    assert found[:, :27].all()
    assert not found[:, 27:].any()
    resampled = cv2.resize(image[:, :20], (33, 33), interpolation=cv2.INTER_CUBIC) + np.float32(0.3)
    assert blank(Micrograph("resampled.tif", resampled, resampled > 0)).all()
