"""The thesis's table of detectors: keypoints, putative matches, inliers, precision, residual and seconds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
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
from semscape.robust.acransac import ac_ransac
from semscape.types import BoolArray, FloatArray, Keypoints, SimulationTruth, TiltSeries

TOLERANCE_PX = 3.0
"""A match is right when it lies this close to where the true cameras and heights put it."""

_WARM_UP_PX = 160


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
        Wall seconds per view, and per pair for matches and geometry, on one thread of this project.
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
        `features` but for the detector, `robust`, and the seed; defaults where left out.
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
        chosen = replace(options, features=replace(options.features, detector=detector))
        _warm_up(series, chosen)
        rows.append(_figures(series, chosen, truth))
    return tuple(rows)


def _warm_up(series: TiltSeries, options: Options) -> None:
    """Compile what is compiled on first use, so that no detector pays for it."""
    corner = slice(0, _WARM_UP_PX)
    view = series.views[0]
    small = replace(view, image=view.image[corner, corner], mask=np.ones_like(view.mask[corner, corner]))
    try:
        found = detect(small, options.features)
        match((0, 1), found, found, ratio=options.features.ratio)
    except SemscapeError:
        pass


def _figures(series: TiltSeries, options: Options, truth: SimulationTruth | None) -> DetectorFigures:
    start = time.perf_counter()
    views = [_detected(series, index, options.features) for index in range(series.n_views)]
    detect_s = (time.perf_counter() - start) / series.n_views
    pairs = [(index, index + 1) for index in range(series.n_views - 1)]
    putative, inliers, failed, match_s = 0, 0, 0, 0.0
    residual, putative_error, error = [], [], []
    for pair in pairs:
        first, second = views[pair[0]], views[pair[1]]
        start = time.perf_counter()
        kept, from_line = np.zeros(0, bool), np.zeros(0)
        xy1 = xy2 = np.zeros((0, 2))
        if first is not None and second is not None:
            found = match(pair, first, second, ratio=options.features.ratio)
            xy1, xy2 = first.xy[found.indices[:, 0]], second.xy[found.indices[:, 1]]
            kept, from_line = _verified(pair, xy1, xy2, series.shape, options)
        match_s += time.perf_counter() - start
        putative += len(xy1)
        inliers += int(kept.sum())
        failed += not kept.any()
        residual.append(from_line[kept])
        if truth is not None:
            off = np.linalg.norm(true_match_px(truth, pair, xy1) - xy2, axis=1)
            known = np.isfinite(off)
            putative_error.append(off[known])
            error.append(off[known & kept])
    right = [values[values <= TOLERANCE_PX] for values in error]
    return DetectorFigures(
        detector=options.features.detector,
        keypoints=sum(len(found) for found in views if found is not None) / series.n_views,
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


def _detected(series: TiltSeries, index: int, options: FeaturesOptions) -> Keypoints | None:
    try:
        return detect(series.views[index], options)
    except SemscapeError:
        return None


def _verified(
    pair: tuple[int, int], xy1: FloatArray, xy2: FloatArray, shape: tuple[int, int], options: Options
) -> tuple[BoolArray, FloatArray]:
    """Return the inliers (M,) of a pair and all distances (M,) to epipolar lines; no inlier without a geometry."""
    none = np.zeros(len(xy1), bool), np.zeros(len(xy1))
    rng = np.random.default_rng([options.run.seed, *pair])
    try:
        geometry = ac_ransac(pair, xy1, xy2, shape, max_trials=options.robust.max_trials, rng=rng)
    except SemscapeError:
        return none
    if geometry.log10_nfa >= 0 or geometry.inliers.sum() < options.robust.min_inliers:
        return none
    return geometry.inliers, geometry.residual_px


def _share_right(errors: list[FloatArray]) -> float | None:
    every = np.concatenate(errors) if errors else np.zeros(0)
    return float((every <= TOLERANCE_PX).mean()) if len(every) else None


def _median(parts: list[FloatArray]) -> float | None:
    every = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.median(every)) if len(every) else None
