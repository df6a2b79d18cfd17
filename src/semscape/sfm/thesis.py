"""The textbook route, as the thesis behind this project takes it: the honest baseline, not the default.

For each view and the next: the essential matrix of a pinhole camera, its rotation and translation, linear
triangulation of every match, and Differential Evolution over all motion variables of the pair for the least
reprojection error of the triangulated points. A SEM is a parallel projector, for which this is ill-posed: from afar,
turning a little and shifting a little look alike. What comes out is told as it is, failures included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import differential_evolution
from scipy.spatial.transform import Rotation

from semscape.compiled import njit
from semscape.options import SfmOptions
from semscape.sfm.calibrate import Calibration, calibrate
from semscape.sfm.models import PARAMETERS_PER_VIEW
from semscape.sfm.parallax import shared_points
from semscape.types import FloatArray, Micrograph, Observations, TiltSeries

_LEAST_SHARED = 8
_ASSUMED_FOCAL_IN_WIDTHS = 10.0
_MOST_POINTS = 400
_LEAST_IN_FRONT = 0.75
_HELD_DEG = 1e-3
_FAR = 1e6


@dataclass(frozen=True)
class ThesisPair:
    """What the route gives for one pair.

    `start` and `best` are the motion (rx, ry, rz rotation vector in rad; azimuth and elevation of the translation) from
    the essential matrix and after the search, `rms_px` their reprojection errors, `in_front` the share of the points
    that lie in front of both cameras, `failure` what went wrong, "" where nothing did.
    """

    start: FloatArray
    best: FloatArray
    rms_px: tuple[float, float]
    in_front: float
    n_evaluations: int
    failure: str

    @property
    def tilt_step_rad(self) -> float:
        """The turn about an axis in the image plane, its sign that of the part about +y."""
        across, along = self.best[:2]
        return float(np.hypot(across, along) * (np.sign(along) or 1.0))


@dataclass(frozen=True)
class ThesisMotion:
    """The pairs in order and the tilts (V,) rad that their steps add up to, the first view's being 0."""

    pairs: tuple[ThesisPair, ...]
    tilt_rad: FloatArray

    @property
    def failures(self) -> tuple[str, ...]:
        """What went wrong, a line per pair."""
        return tuple(pair.failure for pair in self.pairs if pair.failure)


def thesis_motion(
    series: TiltSeries, observations: Observations, options: SfmOptions, *, rng: np.random.Generator
) -> ThesisMotion:
    """Find the motion from each view to the next by the essential matrix and Differential Evolution.

    Parameters
    ----------
    series : TiltSeries
        Its working distance over its pixel size is the focal length; where it has none, ten image widths are assumed.
    observations : Observations
        Tracks.
    options : SfmOptions
        Generations, population and strategy.
    rng : numpy.random.Generator

    References
    ----------
    Longuet-Higgins 1981, doi:10.1038/293133a0 (eight points); Hartley & Sturm 1997, doi:10.1006/cviu.1997.0547
    (linear triangulation); Storn & Price 1997, doi:10.1023/A:1008202821328.
    """
    pairs = tuple(_pair(series, observations, index, options, rng) for index in range(series.n_views - 1))
    steps = np.array([pair.tilt_step_rad for pair in pairs])
    return ThesisMotion(pairs, np.concatenate([[0.0], np.cumsum(steps)]))


def thesis_calibration(
    series: TiltSeries, observations: Observations, options: SfmOptions, *, rng: np.random.Generator
) -> tuple[Calibration, ThesisMotion]:
    """Return a calibration whose tilts are those of the thesis's route, for the stages that follow.

    The mean tilt is the one that is told; rolls, scales and translations are fitted under the tilts, which are held.
    The route does not say how well they are known: their sigmas and that of the height scale are NaN.

    Raises
    ------
    NoAnswerError
        Where nothing can be made of the tilts that come out.
    """
    found = thesis_motion(series, observations, options, rng=rng)
    told = series.tilt_rad
    offset = np.nanmean(told - found.tilt_rad) if np.isfinite(told).any() else -found.tilt_rad.mean()
    views = tuple(_told(view, float(tilt)) for view, tilt in zip(series.views, found.tilt_rad + offset, strict=True))
    held = replace(options, prior_tilt_deg=_HELD_DEG)
    calibration = calibrate(replace(series, views=views), observations, held, rng=rng)
    covariance = calibration.reconstruction.covariance.copy()
    tilts = np.arange(1, len(covariance), PARAMETERS_PER_VIEW)
    covariance[tilts] = covariance[:, tilts] = np.nan
    reconstruction = replace(
        calibration.reconstruction,
        covariance=covariance,
        tilt_sigma_rad=np.full(series.n_views, np.nan),
        tilt_prior_rad=told,
        tilt_source="thesis",
        height_scale_relative_sigma=np.nan,
    )
    return replace(calibration, reconstruction=reconstruction), found


def _told(view: Micrograph, tilt_rad: float) -> Micrograph:
    return replace(view, metadata=replace(view.metadata, tilt_rad=tilt_rad))


def _pair(
    series: TiltSeries, observations: Observations, index: int, options: SfmOptions, rng: np.random.Generator
) -> ThesisPair:
    x1, x2 = shared_points(observations, index, index + 1)
    between = f"{series.names[index]} - {series.names[index + 1]}"
    if len(x1) < _LEAST_SHARED:
        nothing = np.full(5, np.nan)
        return ThesisPair(nothing, nothing, (np.nan, np.nan), 0.0, 0, f"{between}: {len(x1)} matches, need 8")
    focal_px = _focal_px(series, index)
    centre = (np.array(series.shape[::-1]) - 1) / 2
    rays = np.hstack([(x1 - centre) / focal_px, (x2 - centre) / focal_px])
    if len(rays) > _MOST_POINTS:
        rays = rays[rng.choice(len(rays), _MOST_POINTS, replace=False)]
    start = _from_essential(rays)

    def cost(population: FloatArray) -> FloatArray:
        return reprojection_errors(population.T, rays) * focal_px

    turn = np.deg2rad(options.max_tilt_deg)
    bounds = [(-turn, turn)] * 3 + [(-np.pi, np.pi), (-np.pi / 2, np.pi / 2)]
    low, high = np.array(bounds).T
    ended = differential_evolution(
        cost,
        bounds,
        strategy=options.de_strategy,
        maxiter=options.de_generations,
        popsize=options.de_population_per_variable,
        tol=options.de_tolerance,
        mutation=(0.4, 0.9),
        recombination=0.9,
        rng=rng,
        polish=False,
        init="sobol",
        updating="deferred",
        vectorized=True,
        x0=np.clip(start, low, high),
    )
    before, after = cost(np.column_stack([start, ended.x]))
    in_front = _share_in_front(ended.x, rays)
    failure = ""
    if in_front < _LEAST_IN_FRONT:
        failure = f"{between}: {in_front:.0%} of the points lie in front of both cameras"
    evaluations = int(ended.nit + 1) * options.de_population_per_variable * 5
    return ThesisPair(start, ended.x, (float(before), float(after)), in_front, evaluations, failure)


def _focal_px(series: TiltSeries, index: int) -> float:
    metadata = series.views[index].metadata
    focal_px = metadata.working_distance_um / metadata.pixel_size_um
    return float(focal_px) if np.isfinite(focal_px) else _ASSUMED_FOCAL_IN_WIDTHS * series.shape[1]


def _from_essential(rays: FloatArray) -> FloatArray:
    """Return the motion (5,) by the normalized eight-point method, the one of four with most points in front."""
    points = np.stack([rays[:, :2], rays[:, 2:]])
    size = np.sqrt((points**2).sum(axis=2).mean()) + 1e-300
    (x1, y1), (x2, y2) = points[0].T / size, points[1].T / size
    design = np.stack([x2 * x1, x2 * y1, x2, y2 * x1, y2 * y1, y2, x1, y1, np.ones(len(x1))], axis=1)
    normalize = np.diag([1 / size, 1 / size, 1.0])
    essential = normalize @ np.linalg.svd(design)[2][-1].reshape(3, 3) @ normalize
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    candidates = [
        np.concatenate(
            [
                Rotation.from_matrix(u @ quarter @ vt).as_rotvec(),
                [np.arctan2(sign * u[1, 2], sign * u[0, 2]), np.arcsin(np.clip(sign * u[2, 2], -1, 1))],
            ]
        )
        for quarter in (turn, turn.T)
        for sign in (1, -1)
    ]
    return max(candidates, key=lambda motion: _share_in_front(motion, rays))


def _share_in_front(motion: FloatArray, rays: FloatArray) -> float:
    depth = np.empty((len(rays), 2))
    _reproject(motion, Rotation.from_rotvec(motion[:3]).as_matrix(), rays, depth)
    return float((depth > 0).all(axis=1).mean())


def reprojection_errors(motions: FloatArray, rays: FloatArray) -> FloatArray:
    """Return the rms reprojection error (N,) of linearly triangulated points, in units of the focal length.

    Parameters
    ----------
    motions : (N, 5) float array
        Rotation vector, azimuth and elevation of the translation, from the first camera to the second.
    rays : (n, 4) float array
        Matches in calibrated coordinates.
    """
    rotations = Rotation.from_rotvec(motions[:, :3]).as_matrix()
    depth = np.empty((len(rays), 2))
    squared = [_reproject(motion, rotation, rays, depth) for motion, rotation in zip(motions, rotations, strict=True)]
    return np.sqrt(np.array(squared) / (2 * len(rays)))


@njit(cache=True, nogil=True, error_model="numpy")
def _reproject(motion: FloatArray, rotation: FloatArray, rays: FloatArray, depth: FloatArray) -> float:
    """Triangulate each match linearly, write its depths in both cameras, and sum the squared errors."""
    azimuth, elevation = motion[3], motion[4]
    t0, t1 = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    t2 = np.sin(elevation)
    rows = np.empty((4, 3))
    total = 0.0
    for n in range(len(rays)):
        u1, v1, u2, v2 = rays[n]
        rows[0] = np.array([1.0, 0.0, -u1])
        rows[1] = np.array([0.0, 1.0, -v1])
        rows[2] = rotation[0] - u2 * rotation[2]
        rows[3] = rotation[1] - v2 * rotation[2]
        right = np.array([0.0, 0.0, u2 * t2 - t0, v2 * t2 - t1])
        normal = rows.T @ rows
        b = rows.T @ right
        c0 = normal[1, 1] * normal[2, 2] - normal[1, 2] ** 2
        c1 = normal[0, 2] * normal[1, 2] - normal[0, 1] * normal[2, 2]
        c2 = normal[0, 1] * normal[1, 2] - normal[0, 2] * normal[1, 1]
        determinant = normal[0, 0] * c0 + normal[0, 1] * c1 + normal[0, 2] * c2
        z = (
            c2 * b[0]
            + (normal[0, 1] * normal[0, 2] - normal[0, 0] * normal[1, 2]) * b[1]
            + (normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2) * b[2]
        ) / determinant
        x = (c0 * b[0] + c1 * b[1] + c2 * b[2]) / determinant
        y = (
            c1 * b[0]
            + (normal[0, 0] * normal[2, 2] - normal[0, 2] ** 2) * b[1]
            + (normal[0, 1] * normal[0, 2] - normal[0, 0] * normal[1, 2]) * b[2]
        ) / determinant
        d2 = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + t2
        p2 = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + t0
        q2 = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + t1
        depth[n, 0], depth[n, 1] = z, d2
        error = (x / z - u1) ** 2 + (y / z - v1) ** 2 + (p2 / d2 - u2) ** 2 + (q2 / d2 - v2) ** 2
        total += error if error < _FAR else _FAR
    return total
