"""Tracks of random points on a random relief under a known motion: series by the hundred, without image processing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from semscape.geometry.cameras import perspective_cameras_of
from semscape.types import BoolArray, FloatArray, Micrograph, Motion, Observations, SemMetadata, TiltSeries

_SIZE_PX = 800
_PIXEL_UM = 0.1
_WAVES = 60


@dataclass(frozen=True)
class TrackRecipe:
    """What a simulated series of tracks is made of; the defaults are what a usual microscope does.

    Parameters
    ----------
    tilts_deg : V float
        True tilts.
    stage_sigma_deg : float or None
        Error of the stage readings that are told; None tells none.
    n_points : int
    noise_px : float
        Noise of a keypoint's coordinate.
    outlier_share : float
        Share of the observations that are off by up to 25 px.
    scale_sigma, anisotropy_sigma : float
        Relative drift of the magnification, and of the x against the y scale, between views.
    roll_sigma_deg : float
    relief_px : float
        Standard deviation of the heights; 0 is a planar specimen.
    seen_share : float
        Chance that a view sees a point.
    distance_um : float
        Distance of the centre of projection; infinite for parallel projection.
    """

    tilts_deg: tuple[float, ...]
    stage_sigma_deg: float | None = None
    n_points: int = 2000
    noise_px: float = 0.3
    outlier_share: float = 0.1
    scale_sigma: float = 0.001
    anisotropy_sigma: float = 0.0
    roll_sigma_deg: float = 0.2
    relief_px: float = 40.0
    seen_share: float = 0.8
    distance_um: float = np.inf


@dataclass(frozen=True)
class SimulatedTracks:
    """A series with its tracks, its true motion, its true points (P, 3) um, and which observations are wrong (K,)."""

    series: TiltSeries
    observations: Observations
    motion: Motion
    points_um: FloatArray
    wrong: BoolArray


def simulate_tracks(recipe: TrackRecipe, *, rng: np.random.Generator) -> SimulatedTracks:
    """Draw one series.

    Examples
    --------
    >>> tracks = simulate_tracks(TrackRecipe((-3.0, 0.0, 3.0), n_points=100), rng=np.random.default_rng(0))
    >>> tracks.series.n_views, tracks.observations.n_points
    (3, 100)
    """
    views = len(recipe.tilts_deg)
    motion = Motion(
        axis_angle_rad=float(np.deg2rad(90 + rng.normal(0, 2))),
        tilt_rad=np.deg2rad(recipe.tilts_deg),
        roll_rad=np.deg2rad(rng.normal(0, recipe.roll_sigma_deg, views)),
        scale_px_per_um=(1 + rng.normal(0, recipe.scale_sigma, views)) / _PIXEL_UM,
        anisotropy=rng.normal(0, 1, views) * recipe.anisotropy_sigma,
        translation_px=(_SIZE_PX - 1) / 2 + rng.normal(0, 8, (views, 2)),
    )
    plane = rng.uniform(-0.45, 0.45, (recipe.n_points, 2)) * _SIZE_PX
    points = np.column_stack([plane, recipe.relief_px * _relief(plane, rng)]) * _PIXEL_UM
    visible = rng.uniform(size=(recipe.n_points, views)) < recipe.seen_share
    visible[visible.sum(axis=1) < 2] = True
    point, view = np.nonzero(visible)
    cameras = perspective_cameras_of(motion, 1 / recipe.distance_um, np.full(2, (_SIZE_PX - 1) / 2))
    xy = np.stack([camera.project(points) for camera in cameras])[view, point]
    xy += rng.normal(0, recipe.noise_px, xy.shape)
    wrong = rng.uniform(size=len(xy)) < recipe.outlier_share
    xy[wrong] += rng.uniform(-25, 25, (int(wrong.sum()), 2))
    told_deg = np.full(views, np.nan)
    if recipe.stage_sigma_deg is not None:
        told_deg = np.asarray(recipe.tilts_deg) + rng.normal(0, 1, views) * recipe.stage_sigma_deg
    return SimulatedTracks(
        _series(np.deg2rad(told_deg)),
        Observations(view.astype(np.int64), point.astype(np.int64), xy),
        motion,
        points,
        wrong,
    )


def _relief(plane_px: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return heights (P,) of mean square 1: a rough sum of random waves 50 to 400 px long."""
    length = np.exp(rng.uniform(np.log(50), np.log(400), _WAVES))
    direction, phase = rng.uniform(0, 2 * np.pi, (2, _WAVES))
    k = 2 * np.pi / length * np.stack([np.cos(direction), np.sin(direction)])
    amplitude = np.sqrt(length / (length.sum() / 2))
    height: FloatArray = np.cos(plane_px @ k + phase) @ amplitude
    return height


def _series(told_rad: FloatArray) -> TiltSeries:
    """Return views without a picture: the vote by shading finds that there is nothing."""
    blank = Micrograph("", np.zeros((_SIZE_PX, _SIZE_PX), np.float32), np.ones((_SIZE_PX, _SIZE_PX), bool))
    return TiltSeries(
        tuple(
            replace(
                blank,
                name=f"view_{index}.tif",
                metadata=SemMetadata(
                    pixel_size_um=_PIXEL_UM,
                    tilt_rad=float(tilt),
                    source={"tilt_rad": "file"} if np.isfinite(tilt) else {},
                ),
            )
            for index, tilt in enumerate(told_rad)
        )
    )
