"""The one straight line from a tilt series to a surface; only this module knows the order of the stages."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any, TypeVar

import numpy as np

from semscape.cluster import Mapper, local_mapper
from semscape.dense.decimate import finished_mesh
from semscape.dense.full_object import FullObject, full_object_surface
from semscape.dense.tiles import surface_in_tiles
from semscape.errors import SemscapeError, TooFewMatchesError
from semscape.features.detect import detect
from semscape.features.significance import keep_significant
from semscape.options import FeaturesOptions, Options, RunOptions
from semscape.report.memory import PeakMemory, release_memory
from semscape.report.summary import build_report, pair_figures
from semscape.robust.pair_geometry import pinhole_calibrations
from semscape.sfm.calibrate import Calibration, calibrate
from semscape.sfm.full_object import calibrate_full_object, require_stage
from semscape.sfm.misfit import misfitting_view
from semscape.sfm.plausibility import require_one_axis, require_tilts
from semscape.sfm.thesis import thesis_calibration
from semscape.sfm.tracks import build_tracks
from semscape.sfm.two_view import Pair, largest_connected_set, match_pair, renumber
from semscape.types import (
    FloatArray,
    Keypoints,
    Matches,
    Observations,
    Result,
    StageReport,
    TiltSeries,
    TwoViewGeometry,
)

Progress = Callable[[str, dict[str, Any] | None], None]
Value = TypeVar("Value")
_Matched = tuple[tuple[Keypoints, ...], tuple[Matches, ...], tuple[TwoViewGeometry, ...]]


def compute(_stage: str, make: Callable[[], Value]) -> Value:
    """Make a stage's value; `semscape.io.work_folder` offers to keep it on disk as well."""
    return make()


def reconstruct(
    series: TiltSeries,
    options: Options | None = None,
    *,
    rng: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    mapper: Mapper | None = None,
    keep: Callable[[str, Callable[[], Any]], Any] = compute,
) -> Result:
    """Reconstruct the surface of a specimen from a tilt series.

    Parameters
    ----------
    series : TiltSeries
        Two or more views, from `load_series` or `simulate`.
    options : Options, optional
        Of every stage; defaults where left out.
    rng : int, optional
        Seed; `options.run.seed` where left out.
    workers : int, optional
        Threads; one per core where left out. The result does not depend on it.
    progress : callable, optional
        Called with a stage's name and None when it starts, and with its figures when it has ended.
    mapper : callable, optional
        A `map` that runs the tasks of a stage, like that of an executor; `workers` threads where left out.
    keep : callable, optional
        Called with a stage's name and a function that makes its value; returns the value, new or kept from before.

    Returns
    -------
    Result
        Everything from keypoints to mesh, with a report.

    Raises
    ------
    BadInputError
        For two views without tilts.
    NoAnswerError
        When the images do not determine a surface: too few matches, no parallax.

    Examples
    --------
    >>> import semscape
    >>> from semscape.simulate import SimulationOptions, simulate
    >>> small = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=256, height_px=256)
    >>> series, truth = simulate("fracture", small, rng=0)
    >>> result = semscape.reconstruct(series, rng=0)
    >>> result.height_map.height_um.shape
    (256, 256)
    """
    options = _seeded(options or Options(), rng)
    seed = options.run.seed
    stages = _Stages(progress)
    require_tilts(series)
    require_one_axis(series)
    elsewhere = mapper is not None
    with nullcontext(mapper) if mapper else local_mapper(workers) as mapper:
        with stages("detect") as figures:
            find = partial(detect, options=options.features)
            keypoints = keep("detect", lambda: tuple(mapper(find, series.views)))
            figures["n_keypoints"] = sum(len(found) for found in keypoints)
            if options.features.selects:
                keypoints = _significant(series, keypoints, options.features, mapper)
                figures["n_kept"] = sum(len(found) for found in keypoints)

        with stages("match") as figures:
            matches, geometries, failures = keep("match", lambda: _match_all(series, keypoints, options, seed, mapper))
            series, keypoints, matches, geometries = _connected(series, keypoints, matches, geometries, failures)
            figures["n_inliers"] = int(sum(geometry.inliers.sum() for geometry in geometries))
            figures["n_pairs"] = len(geometries)
            matched = keypoints, matches, geometries

        with stages("calibrate") as figures:
            calibration, misfits, failed = keep("calibrate", partial(_calibrated, series, matched, options, seed))
            failures = [*failures, *failed]
            for misfit in misfits:
                series, matched = _without_misfit(series, matched, misfit)
            keypoints, matches, geometries = matched
            reconstruction = calibration.reconstruction
            figures["rms_px"] = reconstruction.rms_px
            figures["tilts_deg"] = np.rad2deg(reconstruction.motion.tilt_rad).round(3).tolist()
            figures["n_tracks"] = len(reconstruction.points_um)
            figures["de_generations"] = len(calibration.evolution.best_cost)
            figures["de_cost"] = calibration.evolution.cost
            figures["noise_sigma_px"] = calibration.sigma_px
            figures["overdispersion"] = calibration.overdispersion
            figures["scan_drift_px"] = calibration.drift_px.round(3).tolist()
            figures["mirror_margin"] = reconstruction.mirror_margin
            figures["camera"], figures["camera_margin"] = reconstruction.camera, reconstruction.camera_margin

        with stages("surface") as figures:
            side_by_side = {"mapper": mapper, "threads": map if elsewhere else mapper}
            surface = keep("surface", lambda: surface_in_tiles(series, reconstruction, options.dense, **side_by_side))
            figures["completeness"] = float(np.isfinite(surface.height_map.height_um).mean())
            figures["pairs"] = [list(pair) for pair in surface.pairs]

        with stages("mesh") as figures:
            mesh, told = finished_mesh(surface.height_map, options.dense.mesh_max_vertices, options.mesh)
            figures |= told

    report = build_report(
        series,
        reconstruction,
        surface.height_map,
        stages=tuple(stages.done),
        pairs=pair_figures(series, matches, geometries, reconstruction.observations),
        keypoints=keypoints,
        options=options,
        failures=tuple(failures),
    )
    return Result(series, keypoints, matches, geometries, reconstruction, surface.height_map, mesh, report)


def reconstruct_full_object(
    series: TiltSeries,
    options: Options | None = None,
    *,
    rng: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[FullObject, tuple[StageReport, ...], tuple[str, ...]]:
    """Reconstruct a whole body from views that the stage has tilted and rotated, as one watertight mesh.

    Parameters
    ----------
    series : TiltSeries
        With the tilt and the rotation of every view; at each rotation two or three tilts some degrees apart.
    options, rng, workers, progress
        As in `reconstruct`.

    Returns
    -------
    FullObject
        Motion, height map of each group of views, merged mesh.
    tuple of StageReport
        What the stages took.
    tuple of str
        Pairs that could not be matched.

    Raises
    ------
    BadInputError
        Where a tilt or a rotation is not known.
    NoAnswerError
        When the images do not determine the body.
    """
    options = _seeded(options or Options(), rng)
    stages = _Stages(progress)
    require_stage(series)
    with local_mapper(workers) as mapper:
        with stages("detect") as figures:
            keypoints = tuple(mapper(partial(detect, options=options.features), series.views))
            figures["n_keypoints"] = sum(len(found) for found in keypoints)
        with stages("match") as figures:
            matches, geometries, failures = _match_all(series, keypoints, options, options.run.seed, mapper)
            figures["n_pairs"] = len(geometries)
        with stages("calibrate") as figures:
            observations = build_tracks(keypoints, matches, geometries)
            motion = calibrate_full_object(series, observations, options.sfm)
            figures["noise_sigma_px"], figures["sense_margin"] = motion.adjustment.sigma_px, motion.sense_margin
            figures["overdispersion"] = motion.overdispersion
        with stages("surface") as figures:
            found = full_object_surface(series, motion, options.dense, mapper=mapper)
            figures["groups"], figures["measured_fraction"] = len(found.maps), found.merged.measured
            figures["n_faces"] = len(found.merged.mesh.faces)
    return found, tuple(stages.done), tuple(failures)


def _seeded(options: Options, rng: int | None) -> Options:
    if rng is None:
        return options
    if isinstance(rng, bool) or not isinstance(rng, int | np.integer) or rng < 0:
        raise ValueError(f"rng must be a seed, a whole number >= 0, got {rng!r}")
    return replace(options, run=RunOptions(seed=int(rng)))


def _significant(
    series: TiltSeries, keypoints: tuple[Keypoints, ...], options: FeaturesOptions, mapper: Mapper
) -> tuple[Keypoints, ...]:
    """Keep the keypoints that are worth matching; each image is scored once, whatever the number of its pairs."""
    model = None
    if options.significance_by == "model":
        from semscape.learning.model_store import load_significance_model  # scikit-learn takes a second to import

        model = load_significance_model(options.significance_model)
    keep = partial(keep_significant, options=options, model=model)
    return tuple(mapper(lambda found: keep(*found), zip(series.views, keypoints, strict=True)))


def _match_all(
    series: TiltSeries, keypoints: tuple[Keypoints, ...], options: Options, seed: int, mapper: Mapper
) -> tuple[tuple[Matches, ...], tuple[TwoViewGeometry, ...], list[str]]:
    """Match every pair; a pair that shares no scene is a line among the failures."""
    calibrations = pinhole_calibrations(series) if options.robust.model == "essential" else None
    attempt = partial(
        _attempt,
        keypoints=keypoints,
        names=series.names,
        shape=series.shape,
        options=options,
        seed=seed,
        calibrations=calibrations,
    )
    outcomes = list(mapper(attempt, pairs_to_match(series.n_views, options.features.pair_reach)))
    failures = [str(outcome) for outcome in outcomes if isinstance(outcome, SemscapeError)]
    found = [outcome for outcome in outcomes if not isinstance(outcome, SemscapeError)]
    return tuple(matches for matches, _ in found), tuple(geometry for _, geometry in found), failures


def pairs_to_match(n_views: int, reach: int) -> list[Pair]:
    """Return the pairs (i1, i2) of views to match: all, or neighbours in tilt with loops.

    Parameters
    ----------
    n_views : int
        Number of views, in the order of their tilts.
    reach : int
        Each view is matched with this many next ones, and with those at 2, 4, 8, ... times that distance, which
        close loops and keep errors from adding up along the series; 0 gives all pairs.

    Examples
    --------
    >>> pairs_to_match(4, 1)
    [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]
    """
    if reach == 0:
        return list(combinations(range(n_views), 2))
    distances = set(range(1, reach + 1))
    distance = 2 * reach
    while distance < n_views:
        distances.add(distance)
        distance *= 2
    return [(i1, i2) for i1, i2 in combinations(range(n_views), 2) if i2 - i1 in distances]


def _attempt(
    pair: Pair,
    *,
    keypoints: tuple[Keypoints, ...],
    names: tuple[str, ...],
    shape: tuple[int, int],
    options: Options,
    seed: int,
    calibrations: list[FloatArray] | None,
) -> tuple[Matches, TwoViewGeometry] | SemscapeError:
    try:
        rng = _stream(seed, "match", *pair)
        pinhole = (calibrations[pair[0]], calibrations[pair[1]]) if calibrations else None
        return match_pair(pair, keypoints, names, shape, options.features, options.robust, rng, pinhole)
    except SemscapeError as error:
        return error


def _connected(
    series: TiltSeries,
    keypoints: tuple[Keypoints, ...],
    matches: tuple[Matches, ...],
    geometries: tuple[TwoViewGeometry, ...],
    failures: list[str],
) -> tuple[TiltSeries, tuple[Keypoints, ...], tuple[Matches, ...], tuple[TwoViewGeometry, ...]]:
    """Keep the largest set of views that hang together, and name those that are left out."""
    kept = largest_connected_set([geometry.pair for geometry in geometries], series.n_views)
    if len(kept) < 2:
        raise TooFewMatchesError(
            f"no two of the {series.n_views} views show the same field of one specimen: {failures[0]}. "
            "Check that all images belong to one series, overlap, and are tilted by at most about 10 deg a step"
        )
    if len(kept) == series.n_views:
        return series, keypoints, matches, geometries
    strangers = ", ".join(name for index, name in enumerate(series.names) if index not in kept)
    left_out = f"left out, because no match ties them to the other views: {strangers} (another specimen or field?)"
    series = series.select(kept, left_out)
    require_tilts(series, left_out)
    return series, tuple(keypoints[i] for i in kept), *renumber(matches, geometries, kept)


def _calibrated(
    series: TiltSeries, matched: _Matched, options: Options, seed: int
) -> tuple[Calibration, tuple[int, ...], tuple[str, ...]]:
    """Return the calibration, the views that do not fit, each counted among those left before it, and failures."""
    observations = build_tracks(*matched)
    failed: tuple[str, ...] = ()
    if options.sfm.method == "thesis":
        calibration, thesis = thesis_calibration(series, observations, options.sfm, rng=_stream(seed, "thesis"))
        failed = thesis.failures
    else:
        calibration = calibrate(series, observations, options.sfm, rng=_stream(seed, "evolve"))
    misfits = []
    while (misfit := _misfit(series, observations, calibration, options, seed)) is not None:
        misfits.append(misfit)
        series, matched = _without_misfit(series, matched, misfit)
        observations = build_tracks(*matched)
        calibration = calibrate(series, observations, options.sfm, rng=_stream(seed, "evolve"))
    return calibration, tuple(misfits), failed


def _misfit(
    series: TiltSeries, observations: Observations, calibration: Calibration, options: Options, seed: int
) -> int | None:
    if options.sfm.method == "thesis":
        return None  # tilts that are wrong by degrees fit no view
    found, rng = calibration.reconstruction, _stream(seed, "misfit", series.n_views)
    return misfitting_view(series, observations, found.observations, found.residual_px, options.sfm, rng=rng)


def _without_misfit(series: TiltSeries, matched: _Matched, misfit: int) -> tuple[TiltSeries, _Matched]:
    kept = tuple(index for index in range(series.n_views) if index != misfit)
    why = (
        f"left out, because it does not fit the motion of the others: {series.names[misfit]} (moved or charged "
        "specimen, another stage rotation or magnification?)"
    )
    keypoints, matches, geometries = matched
    return series.select(kept, why), (tuple(keypoints[i] for i in kept), *renumber(matches, geometries, kept))


def _stream(seed: int, stage: str, *indices: int) -> np.random.Generator:
    """Return a stage's own random stream, the same whatever the order and number of workers."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(stage.encode()), *indices]))


class _Stages:
    """Times the stages and tells the caller of each."""

    def __init__(self, progress: Progress | None) -> None:
        self.done: list[StageReport] = []
        self._progress = progress

    def __call__(self, name: str) -> _Stage:
        return _Stage(name, self.done, self._progress)


class _Stage:
    def __init__(self, name: str, done: list[StageReport], progress: Progress | None) -> None:
        self._name, self._done, self._progress = name, done, progress
        self._figures: dict[str, Any] = {}

    def __enter__(self) -> dict[str, Any]:
        if self._progress:
            self._progress(self._name, None)
        self._memory = PeakMemory()
        self._start = time.perf_counter()
        return self._figures

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        release_memory()
        if kind is None:
            seconds = time.perf_counter() - self._start
            self._done.append(StageReport(self._name, seconds, self._figures, self._memory.peak_mb()))
            if self._progress:
                self._progress(self._name, self._figures)
