"""What matching half of the keypoints costs and saves, end to end, on specimens that the model has never seen."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from semscape.errors import SemscapeError
from semscape.evaluate.align import align_points
from semscape.experiments.study import Setting
from semscape.experiments.true_matches import true_points_um
from semscape.features.detect import detect
from semscape.features.match import match
from semscape.features.significance import best_rows, keep_significant, keypoints_at
from semscape.learning.dataset import Dataset
from semscape.learning.model_store import load_significance_model, significance_model
from semscape.learning.run import ROWS_PER_GROUP, train_model
from semscape.options import Options
from semscape.sfm.calibrate import calibrate
from semscape.sfm.tracks import build_tracks
from semscape.sfm.two_view import match_pair
from semscape.types import Keypoints, Reconstruction, SimulationTruth, TiltSeries

EFFECT_COLUMNS = (
    "series", "chosen by", "keypoints per image", "scoring (s)", "matching (s)", "times faster", "inliers kept",
    "tracks kept", "rms (px)", "tilt span (deg)", "height scale against all keypoints (%)",
    "tilt error (deg)", "height error (um)",
)  # fmt: skip
SPEED_COLUMNS = (
    "series",
    "keypoints per image",
    "matching all (s)",
    "scoring (s)",
    "matching half (s)",
    "times faster",
)
_COUNTS = (10_000, 20_000, 30_000)
_REPEATS = 3
_KEEP = 0.5
_WARM_UP = 200
_LEAST_COMMON = 50
_MAD_TO_SIGMA = 1.4826
# View, x and y of an observation, and the height of its point.
Heights = dict[tuple[int, float, float], float]


@dataclass(frozen=True)
class _Outcome:
    """What the keypoints of a series come to; errors against the truth where it is known."""

    inliers: int
    tracks: int = 0
    rms_px: float = math.nan
    tilt_span_deg: float = math.nan
    heights: Heights = field(default_factory=dict)
    tilt_error_deg: float | None = None
    height_error_um: float | None = None


def effect_rows(
    dataset: Dataset,
    groups: Sequence[tuple[str, TiltSeries, SimulationTruth | None]],
    options: Options,
    setting: Setting,
) -> tuple[tuple[Any, ...], ...]:
    """Return the rows of the table: per series all keypoints, the half that the model chooses, and the rivals'."""
    specimen = np.array(dataset.specimen)[dataset.group]
    is_simulated = np.char.find(np.array(dataset.groups), "-")[dataset.group] > 0
    rows: list[tuple[Any, ...]] = []
    for name, series, truth in groups:
        unseen = specimen != name.split("-")[0]
        models = {"model, all other specimens": dataset.only(unseen)}
        if (unseen & is_simulated).any():
            models["model, simulated alone"] = dataset.only(unseen & is_simulated)
        rows += _series_rows(name, series, truth, models, options, setting)
    return tuple(rows)


def speed_rows(groups: Sequence[tuple[str, TiltSeries]], options: Options) -> tuple[tuple[Any, ...], ...]:
    """Return what half the keypoints save in each series that has enough of them, with the model that ships.

    The seconds are processor time of one thread for all pairs, and for scoring all images; each the least of a few.
    """
    half = replace(options.features, significance_keep=_KEEP)
    model = load_significance_model("")
    rng = np.random.default_rng(options.run.seed)
    rows = []
    for name, series in groups:
        found = tuple(detect(view, options.features) for view in series.views)
        for count in _COUNTS:
            if count > min(len(each) for each in found):
                continue
            some = tuple(keypoints_at(each, np.sort(rng.permutation(len(each))[:count])) for each in found)
            seconds = []
            for _ in range(_REPEATS):
                start = time.process_time()
                kept = tuple(
                    keep_significant(view, each, half, model) for view, each in zip(series.views, some, strict=True)
                )
                scoring = time.process_time() - start
                seconds.append((_match_seconds(some), scoring, _match_seconds(kept)))
            whole, scoring, halved = (min(column) for column in zip(*seconds, strict=True))
            rows.append((name, count, whole, scoring, halved, whole / (scoring + halved)))
    return tuple(rows)


def _series_rows(
    name: str,
    series: TiltSeries,
    truth: SimulationTruth | None,
    training: dict[str, Dataset],
    options: Options,
    setting: Setting,
) -> list[tuple[Any, ...]]:
    found = tuple(detect(view, options.features) for view in series.views)
    _match_seconds(tuple(keypoints_at(each, np.arange(min(len(each), _WARM_UP))) for each in found))  # compiles
    whole = _match_seconds(found)
    base = _outcome(series, truth, found, options)
    rows: list[tuple[Any, ...]] = [(name, "all", _mean_count(found), 0.0, whole, 1.0, *_compared(base, base))]
    half = replace(options.features, significance_keep=_KEEP)
    chosen_by: dict[str, Any] = {}
    for label, rows_to_learn in training.items():
        model = significance_model(train_model(rows_to_learn, seed=setting.seed, rows_per_group=ROWS_PER_GROUP))
        keep_significant(series.views[0], keypoints_at(found[0], np.arange(min(len(found[0]), _WARM_UP))), half, model)
        chosen_by[label] = (half, model)
    for rival in ("response", "scale"):
        chosen_by[rival] = (replace(half, significance_by=rival), None)
    rng = np.random.default_rng(setting.seed)
    for label in (*chosen_by, "random"):
        start = time.process_time()
        if label == "random":
            kept = tuple(keypoints_at(each, best_rows(rng.random(len(each)), _KEEP)) for each in found)
        else:
            features, model = chosen_by[label]
            kept = tuple(
                keep_significant(view, each, features, model) for view, each in zip(series.views, found, strict=True)
            )
        scoring = time.process_time() - start
        matching = _match_seconds(kept)
        faster = whole / (scoring + matching)
        after = _outcome(series, truth, kept, options)
        rows.append((name, label, _mean_count(kept), scoring, matching, faster, *_compared(after, base)))
    return rows


def _compared(after: _Outcome, before: _Outcome) -> tuple[Any, ...]:
    """Return the last columns of a row."""
    return (
        after.inliers / before.inliers,
        after.tracks / before.tracks,
        after.rms_px,
        after.tilt_span_deg,
        _height_scale_percent(before.heights, after.heights),
        after.tilt_error_deg,
        after.height_error_um,
    )


def _outcome(
    series: TiltSeries, truth: SimulationTruth | None, keypoints: tuple[Keypoints, ...], options: Options
) -> _Outcome:
    features = replace(options.features, guided=False)
    found = []
    for pair in combinations(range(series.n_views), 2):
        rng = np.random.default_rng([options.run.seed, *pair])
        try:
            found.append(match_pair(pair, keypoints, series.names, series.shape, features, options.robust, rng))
        except SemscapeError:
            continue
    inliers = sum(int(geometry.inliers.sum()) for _, geometry in found)
    try:
        tracks = build_tracks(keypoints, tuple(m for m, _ in found), tuple(g for _, g in found))
        result = calibrate(series, tracks, options.sfm, rng=np.random.default_rng(options.run.seed)).reconstruction
    except SemscapeError:
        return _Outcome(inliers)
    seen = result.observations
    places = zip(seen.view.tolist(), *seen.xy.T.tolist(), strict=True)
    heights = dict(zip(places, result.points_um[seen.point, 2].tolist(), strict=True))
    span = float(np.rad2deg(np.ptp(result.motion.tilt_rad)))
    errors = (None, None) if truth is None else _errors(result, truth)
    return _Outcome(inliers, tracks.n_points, result.rms_px, span, heights, *errors)


def _errors(result: Reconstruction, truth: SimulationTruth) -> tuple[float, float]:
    """Return the error of the tilts but for a common turn, rms in deg, and the robust sigma of the heights in um.

    A point is compared with the true surface that the reference view shows where the point was observed there, after a
    rigid alignment.
    """
    tilt = np.rad2deg(result.motion.tilt_rad - truth.motion.tilt_rad)
    seen = result.observations
    rows = np.flatnonzero((seen.view == result.reference) & (result.weights > 0))
    true, _ = true_points_um(truth, result.reference, seen.xy[rows])
    known = np.isfinite(true[:, 2])
    found, true = result.points_um[seen.point[rows[known]]], true[known]
    off = align_points(found, true, "rigid").apply(found)[:, 2] - true[:, 2]
    return float(np.std(tilt)), float(_MAD_TO_SIGMA * np.median(np.abs(off)))


def _height_scale_percent(whole: Heights, half: Heights) -> float:
    """Return by how many percent the same keypoints lie farther from their median height than with all keypoints."""
    common = sorted(whole.keys() & half.keys())
    if len(common) < _LEAST_COMMON:
        return np.nan
    before, after = (np.array([heights[place] for place in common]) for heights in (whole, half))
    # A median of ratios: a wrong track moves it little.
    before, after = before - np.median(before), after - np.median(after)
    far = np.abs(before) > np.median(np.abs(before))
    return float(100 * (np.median(after[far] / before[far]) - 1))


def _match_seconds(keypoints: tuple[Keypoints, ...]) -> float:
    start = time.process_time()
    for pair in combinations(range(len(keypoints)), 2):
        match(pair, keypoints[pair[0]], keypoints[pair[1]], ratio=0.8)
    return time.process_time() - start


def _mean_count(keypoints: tuple[Keypoints, ...]) -> float:
    return float(np.mean([len(found) for found in keypoints]))
