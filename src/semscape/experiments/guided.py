"""What the second matching pass along the epipolar lines adds, how precise that is, and what the tilts gain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from semscape.cluster import local_mapper
from semscape.experiments.study import Setting, Table
from semscape.experiments.true_matches import true_match_px
from semscape.features.detect import detect
from semscape.features.guided import add_guided_matches, is_parallel
from semscape.io.series import load_series
from semscape.options import Options
from semscape.sfm.calibrate import calibrate
from semscape.sfm.tracks import build_tracks
from semscape.sfm.two_view import match_pair
from semscape.simulate import PRESETS, simulate
from semscape.types import FloatArray, Keypoints, Matches, SimulationTruth, TiltSeries, TwoViewGeometry

_SIMULATED = (
    ("fracture", "nominal", 0),
    ("fracture", "nominal", 1),
    ("fracture", "nominal", 2),
    ("spheres", "nominal", 1),
    ("pollen", "nominal", 0),
    ("fracture", "hard", 2),
)
_MEASURED = ("potamogeton1", "quartz", "dsa")
_RIGHT_WITHIN_PX = 2.0
_COLUMNS = (
    "series",
    "inliers",
    "inliers added",
    "right within 2 px",
    "added right within 2 px",
    "median residual (px)",
    "added median residual (px)",
    "tracks",
    "tracks guided",
    "of 3 views and more",
    "of 3 views and more guided",
    "tilt error that images show (deg rms)",
    "guided tilt error that images show (deg rms)",
    "tilt sigma (deg)",
    "guided tilt sigma (deg)",
)
_Pass = tuple[tuple[Matches, ...], tuple[TwoViewGeometry, ...]]


def guided_table(setting: Setting) -> Table:
    """Return the table of first and guided pass over simulated and, where there are any, measured series.

    Parameters
    ----------
    setting : Setting
        Its seed is added to that of each simulated series; a quick run has one small series.

    Returns
    -------
    Table
        A row per series, all pairs together. Precision and tilt errors are known for simulated series alone.
    """
    rows = tuple(_row(name, series, truth, setting) for name, series, truth in _series(setting))
    left_out = " A quick run: one small series." if setting.quick else " No measured series at hand."
    measured = "" if any(row[3] is None for row in rows) else left_out
    return Table(
        name="guided",
        title="Matching again along the epipolar lines",
        columns=_COLUMNS,
        rows=rows,
        note="A match is right within 2 px of where the true cameras and heights put it. The tilt error is free of a "
        f"common turn and of the height scale, which no image of a tilt series tells.{measured}",
    )


def _series(setting: Setting) -> Iterator[tuple[str, TiltSeries, SimulationTruth | None]]:
    if setting.quick:
        small = replace(PRESETS["nominal"], tilts_deg=(-5.0, 0.0, 5.0), width_px=256, height_px=256)
        yield "fracture, small", *simulate("fracture", small, rng=setting.seed)
        return
    for specimen, preset, seed in _SIMULATED:
        name = f"{specimen}, {preset}, seed {seed + setting.seed}"
        yield name, *simulate(specimen, PRESETS[preset], rng=seed + setting.seed, workers=setting.workers)
    for name in _MEASURED:
        folder = setting.data / "tilt_series" / name if setting.data else None
        if folder and folder.is_dir():
            yield name, load_series(folder), None


def _row(name: str, series: TiltSeries, truth: SimulationTruth | None, setting: Setting) -> tuple[Any, ...]:
    options = Options().with_settings(["features.guided=false"])
    with local_mapper(setting.workers) as mapper:
        keypoints = tuple(mapper(partial(detect, options=options.features), series.views))

        def both(pair: tuple[int, int]) -> tuple[tuple[Matches, TwoViewGeometry], tuple[Matches, TwoViewGeometry]]:
            rng = np.random.default_rng([setting.seed, *pair])
            found, geometry = match_pair(
                pair, keypoints, series.names, series.shape, options.features, options.robust, rng
            )
            if not is_parallel(geometry):
                return (found, geometry), (found, geometry)
            one, two = (keypoints[i] for i in pair)
            return (found, geometry), add_guided_matches(found, geometry, one, two, ratio=options.features.ratio)

        pairs = list(mapper(both, combinations(range(series.n_views), 2)))
    first: _Pass = tuple(p[0][0] for p in pairs), tuple(p[0][1] for p in pairs)
    guided: _Pass = tuple(p[1][0] for p in pairs), tuple(p[1][1] for p in pairs)
    errors, added_errors = _errors(keypoints, truth, first, guided)
    residuals, added_residuals = _residuals(first, guided)
    calibrated = [_calibrated(series, truth, keypoints, chosen, options, setting.seed) for chosen in (first, guided)]
    return (
        name,
        len(residuals),
        len(added_residuals),
        _share_right(errors),
        _share_right(added_errors),
        _median(residuals),
        _median(added_residuals),
        *(value for values in zip(*calibrated, strict=True) for value in values),
    )


def _errors(
    keypoints: tuple[Keypoints, ...], truth: SimulationTruth | None, first: _Pass, guided: _Pass
) -> tuple[FloatArray, FloatArray]:
    """Return the distances of the inliers, and of the added ones, from the true matches, in px where known."""
    if truth is None:
        return np.empty(0), np.empty(0)
    errors: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    for old, old_geometry, new, new_geometry in zip(*first, *guided, strict=True):
        i1, i2 = old.pair
        before = old.indices[old_geometry.inliers]
        after = new.indices[new_geometry.inliers]
        for kept, indices in zip(errors, (before, after[~_among(after, before)]), strict=True):
            expected = true_match_px(truth, old.pair, keypoints[i1].xy[indices[:, 0]])
            distance = np.linalg.norm(expected - keypoints[i2].xy[indices[:, 1]], axis=1)
            kept.append(distance[np.isfinite(distance)])
    return np.concatenate(errors[0]), np.concatenate(errors[1])


def _residuals(first: _Pass, guided: _Pass) -> tuple[FloatArray, FloatArray]:
    before, added = [], []
    for old, old_geometry, new, new_geometry in zip(*first, *guided, strict=True):
        before.append(old_geometry.residual_px[old_geometry.inliers])
        fresh = new_geometry.inliers & ~_among(new.indices, old.indices[old_geometry.inliers])
        added.append(new_geometry.residual_px[fresh])
    return np.concatenate(before), np.concatenate(added)


def _among(indices: Any, others: Any) -> Any:
    """Tell which rows of `indices` (M, 2) are rows of `others`."""
    span = 1 + max(int(indices.max(initial=0)), int(others.max(initial=0)))
    return np.isin(indices[:, 0] * span + indices[:, 1], others[:, 0] * span + others[:, 1])


def _calibrated(
    series: TiltSeries,
    truth: SimulationTruth | None,
    keypoints: tuple[Keypoints, ...],
    chosen: _Pass,
    options: Options,
    seed: int,
) -> tuple[int, int, float | None, float]:
    """Return the tracks, those of three views and more, the tilt error in deg rms and the mean tilt sigma in deg."""
    observations = build_tracks(keypoints, *chosen)
    views = np.bincount(observations.point)
    found = calibrate(series, observations, options.sfm, rng=np.random.default_rng(seed)).reconstruction
    sigma = round(float(np.rad2deg(found.tilt_sigma_rad).mean()), 4)
    if truth is None:
        return len(views), int((views >= 3).sum()), None, sigma
    error = np.rad2deg(found.motion.tilt_rad - truth.motion.tilt_rad)
    design = np.column_stack([np.ones(len(error)), truth.motion.tilt_rad])
    seen = error - design @ np.linalg.lstsq(design, error, rcond=None)[0]
    return len(views), int((views >= 3).sum()), round(float(np.sqrt(np.mean(seen**2))), 4), sigma


def _share_right(errors: FloatArray) -> float | None:
    return round(float((errors <= _RIGHT_WITHIN_PX).mean()), 4) if len(errors) else None


def _median(values: FloatArray) -> float | None:
    return round(float(np.median(values)), 3) if len(values) else None
