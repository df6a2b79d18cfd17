"""Gaussian blobs whose centres are known, as a camera would see them: each pixel is a mean over its square."""

from __future__ import annotations

import numpy as np
from scipy.special import erf


def blobs(centres: np.ndarray, sigma: float, shape: tuple[int, int], height: float = 60.0) -> np.ndarray:
    """Return hills and pits in turn: alone on a flat field a hill would be clipped by the local normalization."""
    image = np.full(shape, 100.0)
    for index, (x, y) in enumerate(centres):
        row, col = (profile(size, centre, sigma) for size, centre in zip(shape, (y, x), strict=True))
        image += (height if index % 2 else -height) * row[:, None] * col
    return image.astype(np.float32)


def profile(size: int, centre: float, sigma: float) -> np.ndarray:
    edges = (np.arange(size + 1) - 0.5 - centre) / (np.sqrt(2) * sigma)
    return np.sqrt(np.pi / 2) * sigma * np.diff(erf(edges))


def offsets(xy: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the offset (F, 2) of the nearest keypoint from each centre that has one within 2 px."""
    offset = xy[None] - centres[:, None]
    nearest = np.linalg.norm(offset, axis=2).argmin(axis=1)
    offset = offset[np.arange(len(centres)), nearest]
    return offset[np.linalg.norm(offset, axis=1) < 2]
