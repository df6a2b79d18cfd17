"""Views of a profile h(column) under noise of their own, drawn without any code of the dense stage but the sampler."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from semscape.dense.sampling import ViewSampler, common_parallax
from semscape.dense.sweep import Views
from semscape.types import FloatArray, Micrograph

SHAPE = (90, 150)
PARALLAX = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])
COLUMNS = np.arange(SHAPE[1], dtype=float)


def look_at(profile: FloatArray, noise: float = 4.0) -> Views:
    """Draw views of a profile h(u), the highest point of each ray seen, with noise of their own."""
    rng = np.random.default_rng(3)
    texture = 128 + 40 * gaussian_filter(rng.normal(size=(SHAPE[0], SHAPE[1])), 1.0) / 0.28
    fine = np.linspace(0, SHAPE[1] - 1, 8 * SHAPE[1])
    height = profile[np.rint(fine).astype(int)]
    samplers = []
    for g in PARALLAX:
        seen = np.full(SHAPE[1], np.nan)
        best = np.full(SHAPE[1], -np.inf)
        for at, u, h in zip(np.rint(fine + g * height).astype(int), fine, height, strict=True):
            if 0 <= at < SHAPE[1] and h > best[at] + 1e-9:
                best[at], seen[at] = h, at - g * h
            elif 0 <= at < SHAPE[1] and h == best[at] and abs(u + g * h - at) < abs(seen[at] + g * h - at):
                seen[at] = u
        known = np.isfinite(seen)
        seen = np.interp(COLUMNS, COLUMNS[known], seen[known])
        row = np.indices(SHAPE, dtype=float)[0]
        image = map_coordinates(texture, [row, np.broadcast_to(seen, SHAPE)], order=3, mode="nearest")
        image = (image + rng.normal(0, noise, SHAPE)).astype(np.float32)
        view = Micrograph("view", image, np.ones(SHAPE, bool))
        affine = np.array([[1.0, 0, 0], [0, 1.0, 0]])
        samplers.append(ViewSampler(view, affine, np.array([g, 0.0]), np.array([1.0, 0.0]), SHAPE, 0.5))
    _, parallax = common_parallax(np.column_stack([PARALLAX, 0 * PARALLAX]))
    sign = np.sign(parallax @ PARALLAX)
    return Views(tuple(samplers), sign * parallax, 2)
