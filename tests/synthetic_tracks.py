"""Tracks of random points under a known motion, without any image processing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

from semscape.geometry.cameras import camera_matrices
from semscape.types import Micrograph, Motion, Observations, SemMetadata, TiltSeries

SIZE_PX = 800
PIXEL_UM = 0.1


@dataclass(frozen=True)
class Tracks:
    """What was made: `points_um` (P, 3) are the true ones, `stage_deg` what the files say."""

    series: TiltSeries
    observations: Observations
    motion: Motion
    points_um: np.ndarray


@cache
def relief_px() -> np.ndarray:
    """Return a smooth random relief (SIZE_PX, SIZE_PX) of about +-100 px."""
    rough = np.random.default_rng(11).normal(size=(SIZE_PX, SIZE_PX))
    coarse, fine = gaussian_filter(rough, 60, mode="wrap"), gaussian_filter(rough, 12, mode="wrap")
    height: np.ndarray = 40 * coarse / coarse.std() + 6 * fine / fine.std()
    return height


def make_motion(tilts_deg: tuple[float, ...], axis_deg: float = 87.0, seed: int = 0, anisotropy: float = 0.0) -> Motion:
    rng = np.random.default_rng(seed)
    views = len(tilts_deg)
    return Motion(
        axis_angle_rad=float(np.deg2rad(axis_deg)),
        tilt_rad=np.deg2rad(tilts_deg),
        roll_rad=np.deg2rad(rng.normal(0, 0.3, views)),
        scale_px_per_um=(1 + rng.normal(0, 0.001, views)) / PIXEL_UM,
        anisotropy=rng.normal(0, 1, views) * anisotropy,
        translation_px=(SIZE_PX - 1) / 2 + rng.normal(0, 8, (views, 2)),
    )


def make_tracks(
    tilts_deg: tuple[float, ...] = (-8.0, -4.0, 0.0, 4.0, 8.0),
    *,
    stage_deg: tuple[float, ...] | None = None,
    axis_deg: float = 87.0,
    n_points: int = 800,
    noise_px: float = 0.3,
    wrong: float = 0.0,
    relief: float = 1.0,
    seen: float = 0.9,
    anisotropy: float = 0.0,
    pixel_size_um: float = PIXEL_UM,
    shading: float = 1.0,
    seed: int = 0,
) -> Tracks:
    """Return tracks of a rough surface.

    `stage_deg` None gives a series without tilts; `wrong` is the share of observations that are off by many px, `seen`
    the chance that a view sees a point, `shading` the sign and strength of brightness by local height.
    """
    rng = np.random.default_rng([seed, 1])
    motion = make_motion(tilts_deg, axis_deg, seed, anisotropy)
    views = motion.n_views
    xy_px = rng.uniform(-0.45, 0.45, (n_points, 2)) * SIZE_PX
    rows, cols = (np.rint(SIZE_PX / 2 + sign * xy_px[:, i]).astype(int) for i, sign in ((1, -1), (0, 1)))
    points = np.column_stack([xy_px, relief * relief_px()[rows, cols]]) * PIXEL_UM
    visible = rng.uniform(size=(n_points, views)) < seen
    visible[np.arange(n_points), rng.integers(0, views, n_points)] = True
    short = visible.sum(axis=1) < 2
    visible[short] = True
    point, view = np.nonzero(visible)
    projected = np.einsum("kij,kj->ki", camera_matrices(motion)[view], points[point]) + motion.translation_px[view]
    xy = projected + rng.normal(0, noise_px, projected.shape)
    bad = rng.uniform(size=len(xy)) < wrong
    xy[bad] += rng.uniform(-25, 25, (int(bad.sum()), 2))

    relief_image = relief_px()
    local = relief_image - gaussian_filter(relief_image, 20, mode="wrap")
    image = (128 + shading * 20 * local / local.std() + rng.normal(0, 3, local.shape)).astype(np.float32)
    known = np.full(views, np.nan) if stage_deg is None else np.deg2rad(stage_deg)
    micrographs = tuple(
        Micrograph(
            f"view_{index}.tif",
            image,
            np.ones(image.shape, bool),
            SemMetadata(
                pixel_size_um=pixel_size_um,
                tilt_rad=float(known[index]),
                source={"tilt_rad": "file"} if np.isfinite(known[index]) else {},
            ),
        )
        for index in range(views)
    )
    observations = Observations(view.astype(np.int64), point.astype(np.int64), xy)
    return Tracks(TiltSeries(micrographs), observations, motion, points)
