"""A large image in tiles gives the keypoints that it gives in one piece."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from semscape.features import sift
from semscape.features.found import Found


def by_place(found: Found) -> np.ndarray:
    """Return a row per keypoint: place, scale, orientation, response and descriptor, sorted."""
    points = found.keypoints
    rows = np.column_stack([points.xy, points.scale_px, points.orientation_rad, points.response, points.descriptors])
    return rows[np.lexsort(rows.T[::-1])]


def test_tiles_find_what_the_whole_image_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.random.default_rng(0).normal(128, 400, (600, 700)).astype(np.float32)
    image = np.clip(cv2.GaussianBlur(noise, (0, 0), 2.0) + cv2.GaussianBlur(4 * noise - 384, (0, 0), 9.0) - 128, 0, 255)
    whole = by_place(sift.find_sift(image.astype(np.uint8), 0.01))
    monkeypatch.setattr(sift, "_LARGEST_WHOLE_PX", 1000)
    monkeypatch.setattr(sift, "_TILE_PX", 256)
    tiled = by_place(sift.find_sift(image.astype(np.uint8), 0.01))
    whole = whole[whole[:, 2] <= sift._LARGEST_SCALE_PX]
    assert len(whole) > 1000
    assert len(tiled) == len(whole)
    same = np.abs(tiled - whole)[:, :5].max(axis=1) < 1e-3
    assert same.mean() > 0.999
