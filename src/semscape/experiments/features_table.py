"""The thesis's table of detectors: keypoints, putative matches, inliers, precision, residual and seconds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from semscape.errors import BadInputError, SemscapeError
from semscape.experiments.true_matches import true_match_px
from semscape.features.detect import DETECTORS, detect
from semscape.features.match import match
from semscape.io.series import load_series
from semscape.io.simulated import TRUTH_JSON, read_truth
from semscape.options import FeaturesOptions, Options
from semscape.robust.pair_geometry import pinhole_calibrations, two_view_geometry
from semscape.sfm.two_view import match_pair
from semscape.types import FloatArray, Keypoints, Matches, Micrograph, SimulationTruth, TiltSeries, TwoViewGeometry

TOLERANCE_PX = 3.0
"""A match is right when it lies this close to where the true cameras and heights put it."""

_WARM_UP_PX = 160
_WARM_UP_MATCHES = 64


@dataclass(frozen=True)
class DetectorFigures:
    """What one detector gave on a series: keypoints are means over the views, all else over consecutive pairs.

    Parameters
    ----------
    detector : str
        "sift", "surf", "orb" or "brief".
    keypoints, putative, inliers : float
        Mean numbers per view, per pair, per pair.
    putative_precision, precision : float or None
        Share of the putative matches and of the inliers within `TOLERANCE_PX` of the true place; None without truth.
    residual_px : float or None
        Median distance of the inliers to their epipolar lines; None where no pair has any.
    error_px : float or None
        Median distance of the right inliers to the true place; None without truth.
    detect_s, match_s : float
        Processor seconds per view, and per pair for matches and geometry; of all threads.
    failed : int
        Pairs without a meaningful geometry; they count as no inlier.
    """

    detector: str
    keypoints: float
    putative: float
    putative_precision: float | None
    inliers: float
    precision: float | None
    residual_px: float | None
    error_px: float | None
    detect_s: float
    match_s: float
    failed: int


def compare_features_of(
    folder: Path, options: Options | None = None, *, progress: Callable[[str], None] | None = None
) -> tuple[DetectorFigures, ...]:
    """Compare the four detectors on the images of a folder; its truth is used where it is a simulated series.

    Raises
    ------
    BadInputError
        For a folder that holds no series, or whose truth is damaged or of other views.
    """
    options = options or Options()
    series = load_series(folder, options.input)
    truth = read_truth(folder) if (folder / TRUTH_JSON).is_file() else None
    if truth is not None and truth.motion.n_views != series.n_views:
        raise BadInputError(
            f"{folder}: {TRUTH_JSON} is of {truth.motion.n_views} views, the folder holds {series.n_views}; simulate "
            f"the series again, or take {TRUTH_JSON} away to compare without truth"
        )
    return compare_features(series, options, truth=truth, progress=progress)


def compare_features(
    series: TiltSeries,
    options: Options | None = None,
    *,
    truth: SimulationTruth | None = None,
    detectors: Iterable[str] = tuple(DETECTORS),
    progress: Callable[[str], None] | None = None,
) -> tuple[DetectorFigures, ...]:
    """Detect, match and verify the consecutive pairs of a series with each detector.

    Parameters
    ----------
    series : TiltSeries
        Two or more views.
    options : Options, optional
        `features` but for the detector and the second matching pass, `robust`, and the seed; defaults where left out.
    truth : SimulationTruth, optional
        Of a simulated series, for precision and error.
    detectors : iterable of str
        Which, in the order of the rows.
    progress : callable, optional
        Called with a detector's name before it runs.

    Returns
    -------
    tuple of DetectorFigures
        One per detector. A detector that finds nothing has zeros, not an error.

    Raises
    ------
    BadInputError
        For an essential matrix (`robust.model`) without working distances.
    ValueError
        If the truth has another number of views than the series.
    """
    options = options or Options()
    if truth is not None and truth.motion.n_views != series.n_views:
        raise ValueError(f"the truth is of {truth.motion.n_views} views, the series has {series.n_views}")
    rows = []
    for detector in detectors:
        if progress:
            progress(detector)
        # The second pass along epipolar lines would hide what a descriptor tells apart on its own.
        chosen = replace(options, features=replace(options.features, detector=detector, guided=False))
        _warm_up(series, chosen)
        rows.append(_figures(series, chosen, truth))
    return tuple(rows)


def _warm_up(series: TiltSeries, options: Options) -> None:
    """Compile what is compiled on first use, so that no detector pays for it."""
    corner = slice(0, _WARM_UP_PX)
    view = series.views[0]
    small = replace(view, image=view.image[corner, corner], mask=np.ones_like(view.mask[corner, corner]))
    with suppress(SemscapeError):
        found = detect(small, options.features)
        match((0, 1), found, found, ratio=options.features.ratio)
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, _WARM_UP_PX, (_WARM_UP_MATCHES, 2))
    with suppress(SemscapeError):
        two_view_geometry(
            (0, 1),
            xy,
            xy + rng.normal(0, 1, xy.shape),
            kind=options.robust.model,
            shapes=(series.shape, series.shape),
            rng=rng,
            max_trials=options.robust.max_trials,
            calibrations=_calibrations(series, (0, 1), options),
            parallax_limited=options.robust.limit_parallax,
        )


def _figures(series: TiltSeries, options: Options, truth: SimulationTruth | None) -> DetectorFigures:
    start = time.process_time()
    views = tuple(_detected(view, options.features) for view in series.views)
    detect_s = (time.process_time() - start) / series.n_views
    pairs = [(index, index + 1) for index in range(series.n_views - 1)]
    putative, inliers, failed, match_s = 0, 0, 0, 0.0
    residual, putative_error, error = [], [], []
    for pair in pairs:
        start = time.process_time()
        found, geometry = _verified(pair, views, series, options)
        match_s += time.process_time() - start
        if geometry is None:
            failed += 1
            found = match(pair, views[pair[0]], views[pair[1]], ratio=options.features.ratio)
        kept = np.zeros(len(found), bool) if geometry is None else geometry.inliers
        putative += len(found)
        inliers += int(kept.sum())
        if geometry is not None:
            residual.append(geometry.residual_px[kept])
        if truth is not None:
            xy1, xy2 = (views[view].xy[rows] for view, rows in zip(pair, found.indices.T, strict=True))
            off = np.linalg.norm(true_match_px(truth, pair, xy1) - xy2, axis=1)
            known = np.isfinite(off)
            putative_error.append(off[known])
            error.append(off[known & kept])
    right = [values[values <= TOLERANCE_PX] for values in error]
    return DetectorFigures(
        detector=options.features.detector,
        keypoints=sum(map(len, views)) / series.n_views,
        putative=putative / len(pairs),
        putative_precision=_share_right(putative_error),
        inliers=inliers / len(pairs),
        precision=_share_right(error),
        residual_px=_median(residual),
        error_px=_median(right),
        detect_s=detect_s,
        match_s=match_s / len(pairs),
        failed=failed,
    )


def _detected(view: Micrograph, options: FeaturesOptions) -> Keypoints:
    try:
        return detect(view, options)
    except SemscapeError:
        none = np.zeros(0)
        return Keypoints(np.zeros((0, 2)), none, none, none, np.zeros((0, 1), np.uint8), options.detector)


def _calibrations(series: TiltSeries, pair: tuple[int, int], options: Options) -> tuple[FloatArray, FloatArray] | None:
    if options.robust.model != "essential":
        return None
    known = pinhole_calibrations(series)
    return known[pair[0]], known[pair[1]]


def _verified(
    pair: tuple[int, int], views: tuple[Keypoints, ...], series: TiltSeries, options: Options
) -> tuple[Matches, TwoViewGeometry | None]:
    """Return a pair's matches and its geometry, None where it has no meaningful one."""
    rng = np.random.default_rng([options.run.seed, *pair])
    known = _calibrations(series, pair, options)
    try:
        return match_pair(pair, views, series.names, series.shape, options.features, options.robust, rng, known)
    except SemscapeError:
        return Matches(pair, np.empty((0, 2), np.int64), np.empty(0)), None


def _share_right(errors: list[FloatArray]) -> float | None:
    every = np.concatenate(errors) if errors else np.zeros(0)
    return float((every <= TOLERANCE_PX).mean()) if len(every) else None


def _median(parts: list[FloatArray]) -> float | None:
    every = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.median(every)) if len(every) else None
